"""Pieces of a document of Markdown."""

from collections.abc import Sequence


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; a bar in a cell ends no column."""
    lines = (head, ["---"] * len(head), *rows)
    cells = ([cell.replace("|", "\\|") for cell in line] for line in lines)
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def bullets(lines: Sequence[str]) -> str:
    """A list of lines."""
    return "\n".join(f"- {line}" for line in lines)


def document(title: str, *parts: str) -> str:
    """Parts below a title, an empty line between them."""
    return "\n\n".join((f"# {title}", *parts)) + "\n"
