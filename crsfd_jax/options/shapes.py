"""Shapes as grids of cells: the digits, and what a user draws in a text file.

A shape is a word: a digit, or a name and the rows of its grid, such as plus=.#./###/.#. Options
hold the grid and not the name of its file, so that they still say everything when it is gone.
"""

import re
from pathlib import Path

GRIDS = {
    "0": ("#####", "#...#", "#...#", "#...#", "#####"),
    "1": ("..#..", ".##..", "..#..", "..#..", ".###."),
    "2": ("#####", "....#", "#####", "#....", "#####"),
    "3": ("#####", "....#", "#####", "....#", "#####"),
    "4": ("#...#", "#...#", "#####", "....#", "....#"),
}
"""Five by five cells each, top row first, as seen from above."""
ALL = "all"
"""Every digit."""
LARGEST = 7
"""Rows and columns of a grid, at most."""
THINNEST = 0.002
"""m, least width of a peg's strokes: it holds the spheres in its corners."""
_MOST_BYTES = 4096
_NAME = re.compile(r"[A-Za-z0-9_-]{1,40}")


def read(text: str) -> tuple[str, ...]:
    """The shapes that an option names: a digit, all, a file with a grid, or several with commas.

    Raises:
      ValueError: one of them cannot be used; "got ..., allowed: ...; what to do".
    """
    shapes = tuple(GRIDS) if text == ALL else tuple(_shape(item) for item in text.split(","))
    if len(set(shapes)) < len(shapes):
        raise ValueError(f"got {text!r}, allowed: every shape once; leave out the second")
    return shapes


def inlined(text: str) -> str:
    """The same option with the grids of its files in it; unchanged if it cannot be used."""
    try:
        return text if text == ALL else ",".join(read(text))
    except ValueError:
        return text


def grid(shape: str) -> tuple[str, ...]:
    """Rows of a shape, top row first, as seen from above."""
    return GRIDS.get(shape) or tuple(shape.partition("=")[2].split("/"))


def label(text: str) -> str:
    """An option without its grids, for file names."""
    return "-".join(item.partition("=")[0] for item in text.split(","))


def _shape(item: str) -> str:
    if item in GRIDS:
        return item
    name, mark, drawn = item.partition("=")
    if mark and _NAME.fullmatch(name):
        _check(item, drawn.split("/") if drawn else [])
        return item
    rows = _rows_of_file(item)
    _check(item, rows)
    name = re.sub(r"[^A-Za-z0-9_-]", "-", Path(item).stem)[:40]
    return f"{name}={'/'.join(rows)}"


def _rows_of_file(item: str) -> list[str]:
    """Lines without empty ones above and below.

    Raises:
      ValueError: there is no such file, or it is not a short text.
    """
    wanted = "allowed: a text file with rows of # and .; choose another"
    file = Path(item)
    try:
        if not file.exists():
            raise FileNotFoundError
        if not file.is_file():
            raise ValueError(f"got {item!r}, which is not a file, {wanted}")
        if file.stat().st_size > _MOST_BYTES:
            raise ValueError(f"got {item!r}, which has more than {_MOST_BYTES} bytes, {wanted}")
        text = file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"got {item!r}, which is not text, {wanted}") from None
    except OSError as error:
        named = "" if error.errno is None else f", which cannot be read ({error.strerror})"
        if not named and ("/" in item or "." in item):
            named = ", which does not exist"
        raise ValueError(
            f"got {item!r}{named}, allowed: {', '.join(GRIDS)}, {ALL}, several such as 0,2, or a "
            "text file with a grid of # and .; choose one of them"
        ) from None
    lines = [line.rstrip() for line in text.splitlines()]
    filled = [number for number, line in enumerate(lines) if line]
    return lines[filled[0] : filled[-1] + 1] if filled else []


def _check(item: str, rows: list[str]) -> None:
    """Refuses a grid that makes no peg.

    Raises:
      ValueError: it is empty, ragged, too large, not in one piece or holds other characters.
    """

    def refuse(found: str, allowed: str) -> None:
        raise ValueError(f"got {item!r}, {found}, allowed: {allowed}; correct the grid")

    for number, row in enumerate(rows, 1):
        if odd := sorted(set(row) - set("#.")):
            refuse(f"which has {odd[0]!r} in row {number}", "# for a cell and . for none")
    cells = {(i, j) for i, row in enumerate(rows) for j, c in enumerate(row) if c == "#"}
    if not cells:
        refuse("which has no cell", "a grid with at least one #")
    for number, row in enumerate(rows, 1):
        if len(row) != len(rows[0]):
            refuse(f"whose row {number} has {len(row)} cells", f"{len(rows[0])} as in row 1")
    if max(len(rows), len(rows[0])) > LARGEST:
        size = f"{len(rows)} rows of {len(rows[0])} cells"
        refuse(f"which has {size}", f"at most {LARGEST} of each")
    if len(_piece(cells)) < len(cells):
        refuse("which is not in one piece", "cells that are joined by their sides")
    for i, j in sorted(cells):
        for other in (i + 1, j + 1), (i + 1, j - 1):
            if other in cells and not {(i, other[1]), (other[0], j)} & cells:
                refuse(
                    f"whose rows {i + 1} and {i + 2} have cells that meet in a corner only",
                    "cells that share sides",
                )


def _piece(cells: set[tuple[int, int]]) -> set[tuple[int, int]]:
    """The cells that sides join to one of them."""
    found, todo = set(), {min(cells)}
    while todo:
        found |= todo
        beside = {(i + a, j + b) for i, j in todo for a, b in ((0, 1), (1, 0), (0, -1), (-1, 0))}
        todo = beside & cells - found
    return found
