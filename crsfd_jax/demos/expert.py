"""The expert of the demonstrated task: SAC under a dense reward, then made sub-optimal by noise.

Guo et al. 2022, section 5.1, train their expert in the same way and call its reward carefully
designed without giving it; this one is ours.
"""

import jax
import jax.numpy as jnp

from crsfd_jax.env import SUCCESS_DEPTH
from crsfd_jax.physics.interface import Surroundings

_LATERAL, _HEIGHT, _TILT = 0.01, 0.1, 0.05
"""m, m and rad: distances at which each term is well above zero."""


def dense_reward(tip: jax.Array, around: Surroundings, terminated: jax.Array) -> jax.Array:
    """At most 0 on every step but the last, which gives 10: hovering never pays.

    Args:
      tip: [N, 6] pose, m and rad.
      terminated: [N] bool, inserted.
    """
    lateral = jnp.linalg.norm(tip[..., :2] - around.socket_offset, axis=-1)
    height = jnp.clip((tip[..., 2] + SUCCESS_DEPTH) / _HEIGHT, 0.0, 1.0)
    tilt = jnp.linalg.norm(tip[..., 3:], axis=-1)
    cost = 0.4 * jnp.tanh(lateral / _LATERAL) + 0.4 * height + 0.2 * jnp.tanh(tilt / _TILT)
    return jnp.where(terminated, 10.0, -0.5 * cost)
