"""What is drawn anew for every episode: start pose, socket offset, shape and friction."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax.physics.interface import PhysicsState, Surroundings
from crsfd_jax.scene.kinematics import Chain, inverse_kinematics

START_HALF_WIDTH = 0.03
"""m: the tip starts in a cube of 6 x 6 x 6 cm (Guo et al. 2022, section 5.2) ..."""
START_HEIGHT = 0.01
"""m: ... whose bottom is this far above the mouth."""
_POOL = 4096


class Distribution(NamedTuple):
    """The episodes of a task."""

    start_qpos: np.ndarray
    """[P, 7] rad, joint angles of tip poses uniform in the start cube, upright."""
    shapes: tuple[int, ...]
    """Rows of the scene's geometry tables, drawn with equal chance."""
    shift: float
    """m, side of the square around the nominal socket in which its offset is uniform."""
    friction: tuple[float, float]
    """Lowest and highest sliding friction coefficient."""


def start_pool(chain: Chain, seed: int = 0, size: int = _POOL) -> np.ndarray:
    """[size, 7] joint angles of upright tip poses, uniform in the start cube."""
    low = np.array([-START_HALF_WIDTH, -START_HALF_WIDTH, START_HEIGHT])
    high = low + 2 * START_HALF_WIDTH
    position = np.random.default_rng(seed).uniform(low, high, (size, 3)).astype(np.float32)
    qpos, _ = jax.jit(inverse_kinematics, static_argnums=3)(
        chain, position, np.zeros((size, 3), np.float32), 60
    )
    return np.asarray(qpos)


def draw(
    distribution: Distribution, key: jax.Array, count: int
) -> tuple[PhysicsState, Surroundings]:
    """Fresh episodes: [count] arms at rest and their surroundings."""
    start_key, offset_key, shape_key, friction_key = jax.random.split(key, 4)
    pool = jnp.asarray(distribution.start_qpos)
    qpos = pool[jax.random.randint(start_key, (count,), 0, len(pool))]
    half = distribution.shift / 2
    low, high = distribution.friction
    shapes = jnp.asarray(distribution.shapes, jnp.int32)
    return (
        PhysicsState(qpos=qpos, qvel=jnp.zeros_like(qpos), warmstart=jnp.zeros_like(qpos)),
        Surroundings(
            shape=shapes[jax.random.randint(shape_key, (count,), 0, len(shapes))],
            socket_offset=jax.random.uniform(offset_key, (count, 2), minval=-half, maxval=half),
            friction=jax.random.uniform(friction_key, (count,), minval=low, maxval=high),
        ),
    )
