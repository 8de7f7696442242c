"""Actions before the first update: at random, or imitating demonstrations.

With demonstrations in the batches a success is known from the first update. Without them a run
has to meet one: after a warm-up at random most runs with a hole up to 4 mm off needed 10,000 to
51,000 steps for that, and one of thirty met none in 300,000. The action that was demonstrated at
the nearest tip pose, with noise, inserts three of ten pegs there in whole episodes
(docs/when_shaping_helps.md).
"""

from typing import Literal

import jax
import jax.numpy as jnp

from crsfd_jax.learn import replay
from crsfd_jax.observation import ACTION_SIZE, TIP_POSE

NOISE = 0.2
"""Standard deviation of what is added to a demonstrated action."""


def action(
    buffer: replay.ReplayState,
    obs: jax.Array,
    key: jax.Array,
    how: Literal["auto", "random", "demos"],
) -> jax.Array:
    """Actions [E, A] for observations [E, O].

    Args:
      buffer: holds the demonstrations; without any, actions are random.
      how: random, uniform between the limits; demos, what was demonstrated at the nearest tip
        pose, with noise; auto, demos where demonstrations are not drawn into batches.
    """
    uniform = jax.random.uniform(key, (len(obs), ACTION_SIZE), minval=-1.0, maxval=1.0)
    if how == "random" or not buffer.num_demos:
        return uniform
    imitated = _imitated(buffer, obs, key)
    if how == "demos":
        return imitated
    return jnp.where(replay.draws_demos(buffer), uniform, imitated)


def _imitated(buffer, obs, key):
    """Actions of the nearest demonstrated poses, in units of POSE_SCALE, with noise."""
    gap = obs[:, None, TIP_POSE] - buffer.storage.obs[: buffer.num_demos, TIP_POSE]
    nearest = jnp.argmin(jnp.sum(gap**2, axis=-1), axis=1)
    noise = NOISE * jax.random.normal(key, (len(obs), ACTION_SIZE))
    return jnp.clip(buffer.storage.action[nearest] + noise, -1.0, 1.0)
