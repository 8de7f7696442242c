"""The potential of a run's options as a function of poses, to be looked at."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax import algorithms, preparation
from crsfd_jax.algorithms import crsfd
from crsfd_jax.config import Config
from crsfd_jax.demos import builtin
from crsfd_jax.demos.dataset import Demonstrations
from crsfd_jax.learn import potential
from crsfd_jax.observation import CLIP, POSE_SCALE, TIP_POSE

Phi = Callable[[np.ndarray], np.ndarray]
"""Potential [...] of upright or tilted poses [..., 6]: tip position (m) and rotation vector (rad)
in the frame of the nominal socket's mouth."""


def fit(config: Config) -> tuple[Phi, np.ndarray]:
    """The potential as CRSfD, or an arm of its ablation, fits it with these options.

    The random numbers are not those of a seed of the run.

    Returns:
      The potential, and poses [K, T, 6] of the tip in the demonstrations, NaN after the end of an
      episode.

    Raises:
      UserError: the demonstrations cannot be used.
    """
    demos = builtin.load(config.demos, config.demo_episodes)
    key = jax.random.key(config.seed)
    given = preparation.make(config, demos)
    fitted = crsfd.prepare(key, given, algorithms.load(config.algorithm).configure(config))

    def phi(poses: np.ndarray) -> np.ndarray:
        features = jnp.clip(jnp.asarray(poses / POSE_SCALE), -CLIP, CLIP)
        return np.asarray(potential.evaluate(fitted, features))

    return phi, tracks(demos)


def tracks(demos: Demonstrations) -> np.ndarray:
    """Tip poses [K, T, 6] of the episodes, m and rad, NaN after the end of each."""
    tip, last = (obs[:, TIP_POSE] * POSE_SCALE for obs in (demos.obs, demos.next_obs))
    found = np.full((len(demos.episode_length), demos.episode_length.max() + 1, 6), np.nan)
    ends = np.cumsum(demos.episode_length)
    for row, end, length in zip(found, ends, demos.episode_length, strict=True):
        row[:length], row[length] = tip[end - length : end], last[end - 1]
    return found
