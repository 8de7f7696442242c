"""Writing files so that a crash leaves either the old content or the new, never a part."""

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from crsfd_jax.errors import UserError

_TEMPORARY = ".tmp"


def write_atomically(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Replaces a file by what `write` puts into a stream; on disk when this returns.

    Raises:
      OSError: the file cannot be written; the old one is then unchanged.
    """
    name = f".{path.name}."
    descriptor, temporary = tempfile.mkstemp(_TEMPORARY, prefix=name, dir=path.parent)
    try:
        with os.fdopen(descriptor, "wb") as stream:
            write(stream)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
    sync(path.parent)


def write_text(path: Path, text: str) -> None:
    """Replaces a file by a text, as `write_atomically` does."""
    write_atomically(path, lambda stream: stream.write(text.encode()))


def reserve(out: str, option: str = "--out") -> None:
    """Makes the folder of a file that an option names, before anything takes time.

    Raises:
      UserError: the file exists, or its folder cannot be made.
    """
    if Path(out).exists():
        raise UserError(
            f"{option}: got {out!r}, which exists, allowed: a new file; choose another name"
        )
    with output(out, option):
        Path(out).absolute().parent.mkdir(parents=True, exist_ok=True)


@contextlib.contextmanager
def output(out: str | Path, option: str = "--out") -> Iterator[None]:
    """Where the block writes what an option names, and nothing else.

    Raises:
      UserError: it cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise UserError(
            f"{option}: got {str(out)!r}, which cannot be written ({error.strerror}), allowed: a "
            "place that can be; choose another"
        ) from None


def remove_leftovers(folder: Path) -> None:
    """Removes what a process that was killed in `write_atomically` left in a folder."""
    for entry in folder.glob(f".*{_TEMPORARY}"):
        entry.unlink(missing_ok=True)


def sync(path: Path) -> None:
    """Makes a file's content, or the names in a folder, survive a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_tree(folder: Path) -> None:
    """Makes a folder and everything under it survive a power cut."""
    for parent, _, names in os.walk(folder):
        for name in names:
            sync(Path(parent, name))
        sync(Path(parent))


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
