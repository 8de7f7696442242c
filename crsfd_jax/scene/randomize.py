"""What is drawn for every episode: start pose, socket, shape, what tells the arm from its model."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax.options.randomisation import Randomisation
from crsfd_jax.physics.interface import PhysicsState, Surroundings
from crsfd_jax.scene.kinematics import Chain, inverse_kinematics

START_HALF_WIDTH = 0.03
"""m: the tip starts in a cube of 6 x 6 x 6 cm (Guo et al. 2022, section 5.2) ..."""
START_HEIGHT = 0.01
"""m: ... whose bottom is this far above the mouth."""
_POOL = 4096
_GAINS, _OFFSET, _DELAY, _NOISE, _YAW = 1001, 1002, 1003, 1004, 1005
"""Folded into a key; far from small numbers, which give the keys that splitting it gives."""


class Distribution(NamedTuple):
    """The episodes of a task."""

    start_qpos: np.ndarray
    """[P, 7] rad, joint angles of tip poses uniform in the start cube, upright."""
    shapes: Sequence[int] | jax.Array
    """Rows of the scene's geometry tables, drawn with equal chance."""
    shift: float | jax.Array
    """m, side of the square around the nominal socket in which its offset is uniform."""
    friction: float
    """Sliding friction coefficient before its factor."""
    randomisation: Randomisation = Randomisation()


def start_pool(chain: Chain, seed: int = 0, size: int = _POOL) -> np.ndarray:
    """[size, 7] joint angles of upright tip poses, uniform in the start cube."""
    low = np.array([-START_HALF_WIDTH, -START_HALF_WIDTH, START_HEIGHT])
    high = low + 2 * START_HALF_WIDTH
    position = np.random.default_rng(seed).uniform(low, high, (size, 3)).astype(np.float32)
    qpos, _ = jax.jit(inverse_kinematics)(chain, position, np.zeros((size, 3), np.float32))
    return np.asarray(qpos)


def draw(
    distribution: Distribution, key: jax.Array, count: int
) -> tuple[PhysicsState, Surroundings]:
    """Fresh episodes: [count] arms at rest and their surroundings."""
    start_key, offset_key, shape_key, friction_key = jax.random.split(key, 4)
    pool = jnp.asarray(distribution.start_qpos)
    qpos = pool[jax.random.randint(start_key, (count,), 0, len(pool))]
    half = distribution.shift / 2
    factor = uniform(friction_key, (count,), distribution.randomisation.friction)
    shapes = jnp.asarray(distribution.shapes, jnp.int32)
    return (
        PhysicsState(qpos=qpos, qvel=jnp.zeros_like(qpos), warmstart=jnp.zeros_like(qpos)),
        Surroundings(
            shape=shapes[jax.random.randint(shape_key, (count,), 0, shapes.size)],
            socket_offset=jax.random.uniform(offset_key, (count, 2), minval=-half, maxval=half),
            friction=distribution.friction * factor,
            **_untold(distribution.randomisation, key, count),
        ),
    )


def uniform(key: jax.Array, shape: tuple[int, ...], ends: tuple[float, ...]) -> jax.Array:
    """Draws from one or more ranges, low high low high ..., each as likely as it is wide."""
    low, high = np.array(ends[::2]), np.array(ends[1::2])
    before = np.concatenate([[0.0], np.cumsum(high - low)])
    along = jax.random.uniform(key, shape, maxval=before[-1])
    which = jnp.searchsorted(jnp.asarray(before[1:-1]), along, side="right")
    low, high, before = (jnp.asarray(x, jnp.float32)[which] for x in (low, high, before))
    return jnp.clip(low + (along - before), low, high)


def _untold(options: Randomisation, key: jax.Array, count: int) -> dict[str, jax.Array]:
    """The fields of surroundings that no model tells; those that are not asked for stay None."""

    def own(number):
        return jax.random.fold_in(key, number)

    fields = {}
    if any(options.socket_yaw):
        fields["socket_yaw"] = uniform(own(_YAW), (count,), options.socket_yaw)
    if {*options.stiffness, *options.damping} != {1.0}:
        ranges = options.stiffness, options.damping
        keys = jax.random.split(own(_GAINS), len(ranges))
        drawn = [uniform(k, (count,), ends) for k, ends in zip(keys, ranges, strict=True)]
        fields["gains"] = jnp.stack(drawn, axis=-1)
    if any(options.encoder_offset):
        fields["encoder_offset"] = uniform(own(_OFFSET), (count, 7), options.encoder_offset)
    if options.delay:
        fields["is_delayed"] = jax.random.bernoulli(own(_DELAY), options.delay, (count,))
    if options.position_noise or options.rotation_noise:
        fields["noise_seed"] = jax.random.bits(own(_NOISE), (count,))
    return fields
