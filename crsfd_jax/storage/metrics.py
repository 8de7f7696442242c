"""metrics.csv: one row for each evaluation of each seed, safe against crashes and resumes."""

import csv
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from crsfd_jax.errors import UserError
from crsfd_jax.storage.files import write_text

KEY_COLUMNS = ("env_steps", "seed")
WALL_CLOCK_COLUMNS = ("time/wall_s", "time/env_steps_per_second")
"""Columns that differ between two otherwise equal runs; leave them out of comparisons."""


def append(path: Path, rows: Sequence[Mapping[str, float]]) -> None:
    """Adds rows and returns when they are on disk; the first rows fix the order of columns.

    Older rows have NaN in a column that is younger than they.

    Args:
      rows: column -> number, `env_steps` and `seed` among them.

    Raises:
      UserError: a column of the file is missing, or the rows have different ones.
      OSError: the file cannot be written.
    """
    if not rows:
        return
    present = _read_lines(path)
    others = [column for column in rows[0] if column not in KEY_COLUMNS]
    old = present[0] if present else [*KEY_COLUMNS, *others]
    younger = [column for column in others if column not in old]
    header = [*old, *younger]
    for row in rows:
        if set(row) != set(header):
            odd = ", ".join(sorted(set(row) ^ set(header)))
            raise UserError(
                f"{path}: columns {odd} are only in the file; continue the run with the program "
                "version that wrote it, or start again with another --out"
            )
    if present and younger:
        grown = [header, *([*line, *["nan"] * len(younger)] for line in present[1:])]
        write_text(path, _to_text(grown))
    lines = [] if present else [header]
    lines += [[_show(row[column]) for column in header] for row in rows]
    with path.open("a", newline="", encoding="utf-8") as stream:
        stream.write(_to_text(lines))
        stream.flush()
        os.fsync(stream.fileno())


def truncate(path: Path, env_steps: int) -> None:
    """Forgets rows after a checkpoint and a last line cut short by a crash.

    A missing file stays missing.

    Args:
      env_steps: of the checkpoint that the run continues from; rows up to it are kept.
    """
    lines = _read_lines(path)
    if not lines:
        path.unlink(missing_ok=True)
        return
    steps = lines[0].index("env_steps")
    kept = [lines[0], *(line for line in lines[1:] if float(line[steps]) <= env_steps)]
    write_text(path, _to_text(kept))


def read(path: Path) -> dict[str, np.ndarray]:
    """Reads the columns, each [rows]; `env_steps` and `seed` are integers.

    A last line cut short by a crash is left out.

    Raises:
      UserError: the file is missing, empty or not such a table.
    """
    lines = _read_lines(path)
    if not lines:
        raise UserError(f"{path}: holds no metrics; is it the folder of a run that has started?")
    table = np.array([[float(cell) for cell in line] for line in lines[1:]])
    columns = dict(zip(lines[0], table.reshape(-1, len(lines[0])).T, strict=True))
    return columns | {name: columns[name].astype(np.int64) for name in KEY_COLUMNS}


def has_rows(path: Path) -> bool:
    """Whether the file is there and holds a row.

    Raises:
      UserError: it is not such a table.
    """
    return len(_read_lines(path)) > 1


def _read_lines(path: Path) -> list[list[str]]:
    """Complete lines as cells, the header first; [] without a file or a complete header."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: cannot be read: {error}") from error
    complete, _, _ = text.rpartition("\n")
    lines = list(csv.reader(complete.split("\n"))) if complete else []
    if lines and not set(KEY_COLUMNS) <= set(lines[0]):
        raise UserError(f"{path}: not a metrics file, its first line lacks env_steps and seed")
    for number, line in enumerate(lines[1:], start=2):
        if len(line) != len(lines[0]) or not all(_is_number(cell) for cell in line):
            raise UserError(
                f"{path}: line {number} is damaged; copy the file back or choose another --out"
            )
    return lines


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _show(value: float) -> str:
    # Nine digits tell any two float32 numbers apart.
    return str(int(value)) if float(value).is_integer() and abs(value) < 1e15 else f"{value:.9g}"


def _to_text(lines: Sequence[Sequence[str]]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(lines)
    return stream.getvalue()
