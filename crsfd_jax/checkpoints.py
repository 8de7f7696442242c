"""Complete states of a run on disk: bit-exact, digest-checked, newest intact one first.

orbax writes the arrays; it neither checks their bytes nor forces all of its files to the
disk, so both are done here. Every leaf goes in as a plain array under its position.
"""

import contextlib
import hashlib
import itertools
import json
import logging
import math
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from orbax.checkpoint import v1 as ocp

from crsfd_jax.errors import UserError
from crsfd_jax.files import sync, sync_tree

KEEP = 2

_log = logging.getLogger(__name__)


class Checkpoint(NamedTuple):
    """A restored state."""

    step: int
    state: Any
    extra: dict[str, Any]


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
    leaves = named_leaves(state)
    arrays = [to_numpy(leaf) for leaf in leaves.values()]
    described = {
        name: description(leaf, array)
        for (name, leaf), array in zip(leaves.items(), arrays, strict=True)
    }
    body = json.dumps({"leaves": described, "extra": extra})
    # orbax refuses empty arrays; their type says all about them.
    stored = {_slot(i): array for i, array in enumerate(arrays) if array.size}
    context = ocp.Context()
    context.array.saving.use_compression = False
    try:
        _discard(folder / str(step))
        with context:
            ocp.save_checkpointables(
                str(folder / str(step)),
                {"state": stored},
                custom_metadata={"body": body, "sha256": _text_digest(body)},
            )
        sync_tree(folder / str(step))
        sync(folder)
    except (OSError, ValueError) as error:
        with contextlib.suppress(OSError):
            _remove_leftovers(folder)
        raise UserError(_storage_message(folder, step, state_bytes(state), error)) from error
    for old in _steps(folder)[KEEP:]:
        _discard(folder / str(old))


def restore(folder: Path, like: Any) -> Checkpoint | None:
    """Reads the newest intact checkpoint; None where there has never been one.

    A damaged one is renamed to `<step>.damaged`, and a warning names it.

    Args:
      like: the state's structure, as arrays or from jax.eval_shape; its shardings are kept.

    Raises:
      UserError: all are damaged, or a checkpoint holds another structure.
    """
    folder = folder.absolute()
    _remove_leftovers(folder)
    for step in _steps(folder):
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


def state_bytes(state: Any) -> int:
    """Size of a checkpoint of a state, or of its structure, on disk."""
    types = map(stored_type, jax.tree.leaves(state))
    return sum(math.prod(shape) * dtype.itemsize for shape, dtype in types)


def _read(path: Path, step: int, like: Any) -> Checkpoint:
    body = _read_body(path)
    expected = named_leaves(like)
    _refuse_other_structure(path, body["leaves"], expected)
    stored = {
        _slot(i): np.empty(*stored_type(leaf))
        for i, leaf in enumerate(expected.values())
        if math.prod(leaf.shape)
    }
    with _damage_reported():
        arrays = ocp.load_checkpointables(str(path), {"state": stored})["state"]
    leaves = []
    for i, (name, leaf) in enumerate(expected.items()):
        array = arrays.get(_slot(i), np.empty(*stored_type(leaf)))
        described = body["leaves"][name]
        if digest(array) != described["sha256"]:
            raise _Damaged(f"digest of {name}")
        leaves.append(from_numpy(array, leaf, described["impl"]))
    state = jax.tree.unflatten(jax.tree.structure(like), leaves)
    return Checkpoint(step, state, body["extra"])


def _read_body(path: Path) -> dict[str, Any]:
    with _damage_reported():
        description: Any = ocp.checkpointables_metadata(str(path)).custom_metadata
        body, digest = description["body"], description["sha256"]
    if _text_digest(body) != digest:
        raise _Damaged("digest of the description")
    return json.loads(body)


@contextlib.contextmanager
def _damage_reported() -> Iterator[None]:
    # orbax answers damaged files with whatever its parsers raise, after logging the whole file.
    orbax_log = logging.getLogger("absl")
    level = orbax_log.level
    orbax_log.setLevel(logging.CRITICAL)
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        raise _Damaged(f"{type(error).__name__}: {str(error)[:80]}") from error
    finally:
        orbax_log.setLevel(level)


def _refuse_other_structure(path: Path, found: dict[str, Any], expected: dict[str, Any]) -> None:
    for name in sorted(found.keys() | expected.keys()):
        before = found.get(name, {}).get("type")
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


def _steps(folder: Path) -> list[int]:
    """Steps with a checkpoint, newest first."""
    names = (entry.name for entry in folder.glob("*") if entry.is_dir())
    return sorted((int(n) for n in names if re.fullmatch("0|[1-9][0-9]*", n)), reverse=True)


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
    return (
        f"{folder}: checkpoint {step} cannot be written, it needs {needed / 1e6:.0f} MB of "
        f"{free / 1e6:.0f} MB free ({str(error)[:120]}); make room and run the same command again"
    )
