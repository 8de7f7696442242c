"""Poses of the tip anywhere in free space, for the conservative half of Algorithm 1.

A pose above the plane of the mouth is drawn and solved for the joint angles that reach it. The
tip pose at those angles is what counts: one that the arm can have.

Source: Guo et al. 2022.
"""

import functools

import jax
import jax.numpy as jnp

from crsfd_jax.learn.potential import FreeSpace
from crsfd_jax.observation import CLIP, POSE_SCALE
from crsfd_jax.scene.build import Scene
from crsfd_jax.scene.kinematics import chain, inverse_kinematics, pose

_WORKSPACE = 0.05
"""m, half width of the workspace along each axis; times the extent it bounds the samples."""
_TILT = 0.15
"""rad, largest rotation of a setpoint; times the extent it bounds the samples."""
_POOL = 16_384


def make(scene: Scene, extent: float, seed: int = 0) -> FreeSpace:
    """A sampler of tip poses, as observations hold them, over a pool that its first use makes.

    Args:
      extent: half width of the sampled space, in workspaces.
    """

    @functools.cache
    def pool() -> jax.Array:
        with jax.ensure_compile_time_eval():
            return _poses(scene, extent, jax.random.key(seed))

    def sample(key: jax.Array, count: int) -> jax.Array:
        return pool()[jax.random.randint(key, (count,), 0, _POOL)]

    return sample


def _poses(scene: Scene, extent: float, key: jax.Array) -> jax.Array:
    """[_POOL, 6]; a pose out of the arm's reach gives the nearest one that it can reach."""
    position_key, rotation_key = jax.random.split(key)
    side, tilt, links = extent * _WORKSPACE, extent * _TILT, chain(scene)
    low, high = jnp.array([-side, -side, 0.0]), jnp.array([side, side, side])
    position = jax.random.uniform(position_key, (_POOL, 3), minval=low, maxval=high)
    vector = jax.random.uniform(rotation_key, (_POOL, 3), minval=-tilt, maxval=tilt)
    qpos, _ = jax.jit(inverse_kinematics)(links, position, vector)
    return jnp.clip(pose(links, qpos) / POSE_SCALE, -CLIP, CLIP)
