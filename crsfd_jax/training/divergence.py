"""Seeds whose numbers are no longer finite: found, told, and kept for inspection."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from crsfd_jax.storage import npz
from crsfd_jax.storage.leaves import named_leaves, to_numpy

_log = logging.getLogger(__name__)


def find(params: Any, losses: Mapping[str, Sequence[float]]) -> dict[int, str]:
    """Index of each seed with a number that is not finite -> the first place of one.

    Args:
      params: pytree [S, ...].
      losses: name -> a number for each seed.
    """
    found: dict[int, str] = {}
    for name, values in (*named_leaves(params).items(), *losses.items()):
        if hasattr(values, "dtype") and not jnp.issubdtype(values.dtype, jnp.floating):
            continue
        finite = np.isfinite(np.asarray(values, np.float32))
        for index in np.flatnonzero(~finite.reshape(len(finite), -1).all(axis=1)):
            found.setdefault(int(index), name)
    return found


def keep(folder: Path, states: Any, index: int, seed: int, env_steps: int, place: str) -> None:
    """Writes all that one seed carries to diverged-seed<seed>-step<env_steps>.npz, and says so.

    Args:
      states: pytree [S, ...]; a file holds its leaves of this seed by their paths, a PRNG key
        as its words.
    """
    own = {name: to_numpy(leaf)[index] for name, leaf in named_leaves(states).items()}
    path = folder / f"diverged-seed{seed}-step{env_steps}.npz"
    npz.write(path, own)
    _log.warning(
        "seed %d diverged: %s not finite at %s steps; it no longer counts, its state is kept in %s",
        *(seed, place, f"{env_steps:,}", path),
    )
