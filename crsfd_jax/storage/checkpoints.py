"""Complete states of a run on disk: bit-exact, digest-checked, newest intact one first.

orbax writes the arrays; it neither checks their bytes nor forces all of its files to the
disk, so both are done here. Every leaf goes in as a plain array under its position.
"""

import contextlib
import errno
import hashlib
import itertools
import json
import logging
import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from crsfd_jax.errors import STOPPED, UserError
from crsfd_jax.storage import array_store
from crsfd_jax.storage.artefacts import KEPT, saved_steps
from crsfd_jax.storage.files import sync, sync_tree
from crsfd_jax.storage.leaves import (
    digest,
    from_numpy,
    key_implementation,
    named_leaves,
    stored_bytes,
    stored_type,
    to_numpy,
    type_name,
)

_log = logging.getLogger(__name__)
_SHORTAGES = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EIO, errno.EACCES)
"""What a machine may lack for a while; a file that is damaged stays so."""


class Checkpoint(NamedTuple):
    """A restored state."""

    step: int
    state: Any
    extra: dict[str, Any]


class _Leaf(NamedTuple):
    """What a checkpoint says about a leaf."""

    type: str
    implementation: str | None
    sha256: str


class _Damaged(Exception):
    """A checkpoint is not what was saved."""


def save(folder: Path, step: int, state: Any, extra: dict[str, Any]) -> None:
    """Writes a checkpoint and forgets all but the newest two; on disk when this returns.

    Args:
      state: pytree of arrays and typed PRNG keys; empty arrays are fine.
      extra: JSON values to keep with it.

    Raises:
      UserError: it cannot be written, such as on a full disk; older checkpoints stay.
    """
    folder = folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    leaves = named_leaves(state)
    arrays = [to_numpy(leaf) for leaf in leaves.values()]
    described = {
        name: {
            "type": type_name(leaf),
            "implementation": key_implementation(leaf),
            "sha256": digest(array),
        }
        for (name, leaf), array in zip(leaves.items(), arrays, strict=True)
    }
    body = json.dumps({"leaves": described, "extra": extra})
    # orbax refuses empty arrays; their type says all about them.
    stored = {_slot(i): array for i, array in enumerate(arrays) if array.size}
    try:
        _discard(folder / str(step))
        _write(folder / str(step), stored, body)
    except (OSError, ValueError) as error:
        with contextlib.suppress(OSError):
            _remove_leftovers(folder)
        message = _storage_message(folder, step, stored_bytes(state), error)
        raise UserError(message, STOPPED) from error
    for old in saved_steps(folder)[KEPT:]:
        _discard(folder / str(old))


def restore(folder: Path, like: Any, at_most: float = math.inf) -> Checkpoint | None:
    """Reads the newest intact checkpoint; None where there has never been one.

    A damaged one is renamed to `<step>.damaged`, and a warning names it.

    Args:
      like: the state's structure, as from jax.eval_shape.
      at_most: a step; checkpoints beyond it are forgotten.

    Raises:
      UserError: all are damaged, or a checkpoint holds another structure.
    """
    folder = folder.absolute()
    _remove_leftovers(folder)
    for step in saved_steps(folder):
        if step > at_most:
            _discard(folder / str(step))
            continue
        try:
            return _read(folder / str(step), step, like)
        except _Damaged as damage:
            aside = (folder / str(step)).rename(_free_name(folder / str(step), "damaged"))
            _log.warning("checkpoint %s is damaged (%s), kept as %s", step, damage, aside.name)
    damaged = sorted(entry.name for entry in folder.glob("*.damaged*"))
    if damaged:
        raise UserError(
            f"{folder}: no intact checkpoint, only {', '.join(damaged)}; restore one from a "
            "copy or start again with another --out"
        )
    return None


def _write(path: Path, stored: dict[str, np.ndarray], body: str) -> None:
    description: Any = {"body": body, "sha256": _text_digest(body)}
    array_store.save(path, stored, description)
    sync_tree(path)
    sync(path.parent)


def _read(path: Path, step: int, like: Any) -> Checkpoint:
    described, extra = _read_body(path)
    expected = named_leaves(like)
    _refuse_other_structure(path, described, expected)
    stored = {
        _slot(i): np.empty(*stored_type(leaf))
        for i, leaf in enumerate(expected.values())
        if math.prod(leaf.shape)
    }
    with _damage_reported():
        arrays = array_store.load(path, stored)
    leaves = []
    for i, (name, leaf) in enumerate(expected.items()):
        array = arrays.get(_slot(i), np.empty(*stored_type(leaf)))
        if digest(array) != described[name].sha256:
            raise _Damaged(f"digest of {name}")
        with _damage_reported():
            leaves.append(from_numpy(array, described[name].implementation))
    state = jax.tree.unflatten(jax.tree.structure(like), leaves)
    return Checkpoint(step, state, extra)


def _read_body(path: Path) -> tuple[dict[str, _Leaf], dict[str, Any]]:
    with _damage_reported():
        description: Any = array_store.describe(path)
        body = description["body"]
        is_intact = _text_digest(body) == description["sha256"]
        found = json.loads(body) if is_intact else {}
        # A digest can be forged: nothing in here is taken for what it should be.
        said = found.get("leaves", {}).items()
        names = ("type", "implementation", "sha256")
        leaves = {name: _Leaf(*(leaf[part] for part in names)) for name, leaf in said}
        extra = dict(found.get("extra", {}))
    if not is_intact:
        raise _Damaged("digest of the description")
    return leaves, extra


@contextlib.contextmanager
def _damage_reported() -> Iterator[None]:
    try:
        yield
    except (MemoryError, jax.errors.JaxRuntimeError):
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno in _SHORTAGES:
            raise
        # orbax answers damaged files with whatever its parsers raise.
        raise _Damaged(f"{type(error).__name__}: {str(error)[:80]}") from error


def _refuse_other_structure(path: Path, found: dict[str, _Leaf], expected: dict[str, Any]) -> None:
    for name in sorted(found.keys() | expected.keys()):
        before = found[name].type if name in found else None
        now = type_name(expected[name]) if name in expected else None
        if before != now:
            raise UserError(
                f"{path}: {name} is {before}, expected {now}; continue it with the program "
                "version that wrote it, or start again with another --out"
            )


def _text_digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _slot(position: int) -> str:
    return f"{position:05d}"


def _discard(path: Path) -> None:
    # Renamed first, so that a kill half way never leaves something that looks complete.
    if path.exists():
        shutil.rmtree(path.rename(_free_name(path, "trash")))


def _free_name(path: Path, ending: str) -> Path:
    names = itertools.chain([ending], (f"{ending}{i}" for i in itertools.count(2)))
    return next(p for p in (path.with_name(f"{path.name}.{n}") for n in names) if not p.exists())


def _remove_leftovers(folder: Path) -> None:
    for pattern in ("*.orbax-checkpoint-tmp*", "*.trash*"):
        for entry in folder.glob(pattern):
            shutil.rmtree(entry)


def _storage_message(folder: Path, step: int, needed: int, error: Exception) -> str:
    free = shutil.disk_usage(folder).free
    reason = "no space left" if "No space left" in str(error) else str(error)[:120]
    return (
        f"{folder}: checkpoint {step} cannot be written ({reason}), it needs {needed / 1e6:.0f} MB "
        f"of {free / 1e6:.0f} MB free; make room and run the same command again"
    )
