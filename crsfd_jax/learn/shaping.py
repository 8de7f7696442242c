"""Potential-based reward shaping of sampled batches, demonstrations and experience alike.

Source: Ng, Harada, Russell 1999; Guo et al. 2022, equation 3.
"""

import dataclasses
from typing import Literal

import jax
import jax.numpy as jnp

from crsfd_jax.learn.replay import Backup


def shape_reward(
    backup: Backup,
    potential: jax.Array,
    next_potential: jax.Array,
    gamma: float,
    terminal: Literal["zero", "keep"],
) -> Backup:
    """Adds gamma^m Phi(s_{t+m}) - Phi(s_t) to the reward summed over m steps.

    That is the sum of the shaped 1-step rewards r + gamma Phi(s') - Phi(s): the potentials in
    between cancel. Phi(s_{t+m}) stands at a truncated step; at a terminal one it is taken as
    zero, which leaves the optimal policy unchanged, or kept.

    Args:
      potential: [...] Phi(s_t).
      next_potential: [...] Phi(s_{t+m}), of `backup.next_obs`.
    """
    if terminal == "zero":
        next_potential = jnp.where(backup.terminated, 0.0, next_potential)
    shaping = gamma**backup.length * next_potential - potential
    return dataclasses.replace(backup, reward=backup.reward + shaping)
