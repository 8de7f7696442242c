"""Notes which files Python code writes, makes, moves or removes."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

CHANGES = ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.link", "os.symlink", "os.truncate")
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_lists: list[list[Path]] = []


def _note(event: str, args: tuple) -> None:
    if not _lists:
        return
    is_write = event == "open" and isinstance(args[2], int) and args[2] & WRITING
    if not is_write and event not in CHANGES:
        return
    for name in args[:1] if is_write else args[:2]:
        if isinstance(name, str | bytes | os.PathLike) and os.fsdecode(name) != os.devnull:
            _lists[-1].append(Path(os.path.realpath(os.fsdecode(name))))


sys.addaudithook(_note)  # Cannot be removed again: it rests while nobody asks.


@contextlib.contextmanager
def noted() -> Iterator[list[Path]]:
    """The paths that are changed while the block lasts, as they are changed."""
    _lists.append([])
    try:
        yield _lists[-1]
    finally:
        _lists.pop()
