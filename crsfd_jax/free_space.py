"""States anywhere in free space, for the conservative half of Algorithm 1 (Guo et al. 2022).

A state is drawn as a tip pose above the plane of the mouth, solved for the joint angles that
reach it, and then observed like any other: joints, pose and velocities belong together.
"""

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax import env
from crsfd_jax.algorithms.method import FreeSpace
from crsfd_jax.physics.interface import PhysicsState
from crsfd_jax.scene.build import Scene
from crsfd_jax.scene.kinematics import chain, inverse_kinematics

_WORKSPACE = 0.05
"""m, half width of the workspace along each axis; times the extent it bounds the samples."""
_TILT = 0.15
"""rad, largest rotation of a setpoint; times the extent it bounds the samples."""
_JOINT_SPEED = 0.3
"""rad/s, standard deviation of joint velocities: that of demonstrated motion at full action."""
_SETPOINT_ERROR = 0.01
"""m, largest distance of setpoint and tip."""
_POOL = 16_384


def make(scene: Scene, extent: float, seed: int = 0) -> FreeSpace:
    """A sampler over a pool of states that is made once.

    Args:
      extent: half width of the sampled space, in workspaces.
    """
    pool = _observations(scene, extent, jax.random.key(seed))

    def sample(key: jax.Array, count: int) -> jax.Array:
        return pool[jax.random.randint(key, (count,), 0, len(pool))]

    return sample


def _observations(scene: Scene, extent: float, key: jax.Array) -> jax.Array:
    """[_POOL, O]; a pose out of the arm's reach gives the nearest state that it can reach."""
    position_key, rotation_key, velocity_key, error_key = jax.random.split(key, 4)
    side, tilt, links = extent * _WORKSPACE, extent * _TILT, chain(scene)
    low, high = jnp.array([-side, -side, 0.0]), jnp.array([side, side, side])
    position = jax.random.uniform(position_key, (_POOL, 3), minval=low, maxval=high)
    vector = jax.random.uniform(rotation_key, (_POOL, 3), minval=-tilt, maxval=tilt)
    qpos, _ = jax.jit(inverse_kinematics)(links, position, vector)
    qvel = _JOINT_SPEED * jax.random.normal(velocity_key, qpos.shape)
    error = jax.random.uniform(
        error_key, (_POOL, 3), minval=-_SETPOINT_ERROR, maxval=_SETPOINT_ERROR
    )
    state = PhysicsState(qpos=qpos, qvel=qvel, warmstart=jnp.zeros_like(qpos))
    return env.observe(links, np.asarray(env.rest_posture(links)), state, error)[1]
