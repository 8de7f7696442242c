"""Reading HDF5 files of unknown origin: no links, no objects, no plugins, bounded memory."""

import contextlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from crsfd_jax import extras
from crsfd_jax.errors import UserError

MAX_OBJECTS = 200_000
MAX_BYTES = 256 * 2**20
"""Of all arrays that are read from a file."""
_MAX_DEPTH = 8
_KINDS = "fiubS"
"""Numbers, flags and texts of fixed length: nothing that refers or allocates on its own."""
_FILTERS = {1, 2, 3}
"""Deflate, shuffle and checksum come with the library; others load code from plugin folders."""
_DAMAGE = (OSError, RuntimeError, ValueError, TypeError, KeyError, MemoryError, OverflowError)
"""What h5py raises on bytes that were never an HDF5 file."""


class Budget:
    """Counts the bytes that are read, and refuses those above MAX_BYTES before they are."""

    def __init__(self):
        self.left = MAX_BYTES

    def take(self, name: str, count: int) -> None:
        """Raises UserError when less is left."""
        if count > self.left:
            raise UserError(f"{name} declares {count} bytes, allowed: at most {self.left}")
        self.left -= count


@contextlib.contextmanager
def open_checked(path: str | Path) -> Iterator[Any]:
    """An h5py.File in which nothing points outside or hides objects.

    Raises:
      UserError: h5py or the file is missing, or the file is damaged or refused.
    """
    extras.require("HDF5 files", "data", "h5py")
    import h5py

    if not Path(path).is_file():
        raise UserError(f"{path}: no such file; check the name")
    try:
        with h5py.File(path, "r") as file:
            _check_tree(h5py, file)
            yield file
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    except _DAMAGE as error:
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise UserError(f"{path}: not a readable HDF5 file: {reason}; copy it again") from error


def read(group: Any, name: str, budget: Budget) -> np.ndarray:
    """A dataset as an array, its size checked before anything is allocated.

    Raises:
      UserError: it is missing, no dataset, or too large.
    """
    import h5py

    dataset = group.get(name)
    if not isinstance(dataset, h5py.Dataset):
        raise UserError(f"{group.name}/{name} is missing")
    budget.take(f"{group.name}/{name}", _bytes(dataset))
    return dataset[()]


def check_total(file: Any) -> None:
    """Checks that all arrays together fit, for a library that reads them as it likes.

    Raises:
      UserError: they declare too much.
    """
    budget, todo = Budget(), [file]
    while todo:
        for item in todo.pop().values():
            if hasattr(item, "keys"):
                todo.append(item)
            else:
                budget.take(item.name, _bytes(item))


def read_text(group: Any, name: str) -> str:
    """A text attribute, or "" if there is none.

    Raises:
      UserError: the attribute is no text.
    """
    value = group.attrs.get(name, "")
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if not isinstance(value, str):
        raise UserError(f"{group.name} attribute {name} is no text")
    return value


def _check_tree(h5py: Any, file: Any) -> None:
    """Visits every object by its links, without following any that is not hard."""
    todo, seen = [(file, 0)], 0
    while todo:
        group, depth = todo.pop()
        if depth > _MAX_DEPTH:
            raise UserError(f"{group.name} is nested more than {_MAX_DEPTH} deep; refused")
        for name in group:
            seen += 1
            if seen > MAX_OBJECTS:
                raise UserError(f"holds more than {MAX_OBJECTS} objects; refused")
            place = f"{group.name.rstrip('/')}/{name}"
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise UserError(f"{place} is a soft or external link; refused, store it itself")
            item = group[name]
            if isinstance(item, h5py.Group):
                todo.append((item, depth + 1))
            elif isinstance(item, h5py.Dataset):
                _check_dataset(item)
            else:
                raise UserError(f"{place} is a {type(item).__name__}; refused")


def _check_dataset(dataset: Any) -> None:
    if dataset.dtype.kind not in _KINDS or dataset.dtype.subdtype is not None:
        raise UserError(f"{dataset.name} holds {dataset.dtype}, allowed: numbers; refused")
    if dataset.external or dataset.is_virtual:
        raise UserError(f"{dataset.name} keeps its values in other files; refused")
    if dataset.shape is None:
        raise UserError(f"{dataset.name} is empty; refused")
    properties = dataset.id.get_create_plist()
    filters = {properties.get_filter(i)[0] for i in range(properties.get_nfilters())}
    if filters - _FILTERS:
        raise UserError(f"{dataset.name} needs HDF5 filters {sorted(filters - _FILTERS)}; refused")
    if dataset.chunks and math.prod(dataset.chunks) * dataset.dtype.itemsize > MAX_BYTES:
        raise UserError(f"{dataset.name} has chunks of {dataset.chunks}; refused")


def _bytes(dataset: Any) -> int:
    return math.prod(dataset.shape) * dataset.dtype.itemsize
