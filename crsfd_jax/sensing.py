"""What an arm believes of itself: joint angles off by their calibration, noisy poses.

Its controller shares the constant part of that belief, for it reads the same encoders: an offset
moves what the arm observes, and where it thinks the socket is, without pulling it anywhere. Noise
differs between readings at 10 Hz; the controller, a hundred times as fast, averages it out, but
holds a setpoint that was built on one noisy reading.
"""

import jax
import jax.numpy as jnp

from crsfd_jax.physics.interface import PhysicsState, Surroundings
from crsfd_jax.scene.kinematics import Chain, pose


def believed(physics: PhysicsState, around: Surroundings) -> PhysicsState:
    """The state as the encoders read it."""
    if around.encoder_offset is None:
        return physics
    return physics.replace(qpos=physics.qpos + around.encoder_offset)


def commanded(
    links: Chain, physics: PhysicsState, around: Surroundings, setpoint: jax.Array
) -> jax.Array:
    """The setpoint [N, 6] for a controller that knows its true pose.

    It is as far from the true pose as the arm's own setpoint is from the pose it believes in.
    """
    if around.encoder_offset is None:
        return setpoint
    return setpoint - (pose(links, believed(physics, around).qpos) - pose(links, physics.qpos))


def noise(around: Surroundings, age: jax.Array, deviation: tuple[float, float]) -> jax.Array | None:
    """[N, 6] m and rad, error of the tip's pose as read at an age, or None.

    Args:
      age: [N] int32, control steps since the episode began.
      deviation: standard deviation along each axis (m) and about each axis (rad).
    """
    if around.noise_seed is None:
        return None

    def one(seed, age):
        key = jax.random.fold_in(jax.random.key(seed), age)
        return jax.random.normal(key, (6,)) * jnp.repeat(jnp.asarray(deviation), 3)

    return jax.vmap(one)(around.noise_seed, age)
