"""The trained policies of a run in one small file: parameters, without a line of code in it."""

from pathlib import Path
from typing import Any

import jax
import numpy as np

from crsfd_jax.errors import UserError
from crsfd_jax.storage import npz
from crsfd_jax.storage.leaves import named_leaves

_MAX_BYTES = 2**30


def save(path: Path, actor: Any) -> None:
    """Writes the actor parameters of all seeds, [S, ...] each, all or nothing."""
    npz.write(path, {name: np.asarray(leaf) for name, leaf in named_leaves(actor).items()})


def load(path: Path, like: Any) -> Any:
    """Reads what `save` wrote.

    Args:
      like: actor parameters [S, ...] of the same structure, as from jax.eval_shape.

    Raises:
      UserError: the file is missing, damaged, or from networks of other sizes.
    """
    expected = named_leaves(like)
    arrays = npz.read(path, {name: np.float32 for name in expected}, _MAX_BYTES)
    for name, leaf in expected.items():
        if arrays[name].shape != leaf.shape:
            raise UserError(f"{path}: {name} is {arrays[name].shape}, expected {leaf.shape}")
    return jax.tree.unflatten(jax.tree.structure(like), [arrays[name] for name in expected])
