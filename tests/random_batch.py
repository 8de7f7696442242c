"""A small batch of random experience, for the losses that learn from it."""

import jax
import jax.numpy as jnp

from crsfd_jax.learn.replay import Backup, Batch

BATCH = 6


def backup(key, obs_size, terminated=None) -> Backup:
    """Backups [BATCH] of 1 to 3 steps; two of them end unless told otherwise."""
    reward_key, obs_key = jax.random.split(key)
    if terminated is None:
        terminated = jnp.asarray([True, False, False, False, True, False])
    return Backup(
        reward=jax.random.normal(reward_key, (BATCH,)),
        next_obs=jax.random.normal(obs_key, (BATCH, obs_size)),
        terminated=terminated,
        length=jnp.asarray([1, 1, 2, 3, 2, 3]),
    )


def batch(obs_size, action_size) -> Batch:
    """The same [BATCH] rows every time, each with its own weight."""
    keys = jax.random.split(jax.random.key(1), 5)
    return Batch(
        obs=jax.random.normal(keys[0], (BATCH, obs_size)),
        action=jax.random.uniform(keys[1], (BATCH, action_size), minval=-1.0),
        weight=jax.random.uniform(keys[2], (BATCH,), minval=0.2),
        one_step=backup(keys[3], obs_size),
        n_step=backup(keys[4], obs_size),
    )
