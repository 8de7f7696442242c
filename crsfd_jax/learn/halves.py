"""Batches of which half are demonstrations and half experience, each half drawn uniformly.

Source: Reddy et al. 2020 (arXiv 1905.11108); Ball et al. 2023 (arXiv 2302.02948), section 4.1.
"""

import jax
import jax.numpy as jnp

from crsfd_jax import config
from crsfd_jax.learn.replay import Draw, ReplayState, draw_rows, follow


def draw(
    state: ReplayState,
    step: jax.Array,
    key: jax.Array,
    shape: tuple[int, int],
    replay: config.Replay,
) -> Draw:
    """Draws all batches [U, B] of vector step `step`, in the place of `replay.draw`.

    The first half of a batch is experience, rounded down; while there is none, all are
    demonstrations. There must be demonstrations. Priorities only tell which rows hold anything.
    """
    demo_key, experience_key = jax.random.split(key)
    updates, size = shape
    demos = jax.random.randint(demo_key, shape, 0, state.num_demos)
    held = (state.priority > 0).at[: state.num_demos].set(False)
    experience = draw_rows(jnp.asarray(held, jnp.float32), experience_key, (updates, size // 2))
    experience = jnp.where(jnp.any(held), experience, demos[:, : size // 2])
    rows = jnp.concatenate([experience, demos[:, size // 2 :]], axis=-1)
    window, alive = follow(state, step, rows, replay.n_step)
    return Draw(rows=window, alive=alive, weight=jnp.ones(shape))
