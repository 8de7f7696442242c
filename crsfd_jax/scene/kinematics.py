"""Kinematics of the arm as batched JAX functions: where the peg's tip is and how it moves.

The chain is read from the compiled model, so there is one description of the arm. The observations
of all engines come from here, which makes them equal for equal joint states.
"""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from crsfd_jax.scene.build import Scene


class Chain(NamedTuple):
    """Fixed transforms from each joint's frame to the next; all joints turn about their z axis."""

    rotations: np.ndarray
    """[8, 3, 3] parent joint frame -> joint frame at zero, the last to the tip."""
    offsets: np.ndarray
    """[8, 3] m, relative to the nominal socket for the first."""
    limits: np.ndarray
    """[7, 2] rad."""


def chain(scene: Scene) -> Chain:
    """Reads the chain off the compiled model."""
    model = scene.model
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    joints, tip = model.jnt_bodyid, scene.tip_site
    rotations = [*data.xmat[joints].reshape(-1, 3, 3), data.site_xmat[tip].reshape(3, 3)]
    positions = [*data.xpos[joints], data.site_xpos[tip]] - scene.nominal
    frames = [(np.eye(3), np.zeros(3)), *zip(rotations, positions, strict=True)]
    pairs = itertools.pairwise(frames)
    steps = [(r0.T @ r1, r0.T @ (p1 - p0)) for (r0, p0), (r1, p1) in pairs]
    return Chain(
        rotations=np.stack([r for r, _ in steps]).astype(np.float32),
        offsets=np.stack([p for _, p in steps]).astype(np.float32),
        limits=model.jnt_range.astype(np.float32),
    )


def tip_pose(chain: Chain, qpos: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Pose of the tip in the nominal socket's frame, and its Jacobian.

    Args:
      qpos: [..., 7] rad.

    Returns:
      position [..., 3] m, rotation [..., 3, 3], Jacobian [..., 6, 7] (linear above angular).
    """
    sin, cos = jnp.sin(qpos), jnp.cos(qpos)
    position = jnp.zeros((*qpos.shape[:-1], 3))
    rotation = jnp.broadcast_to(jnp.eye(3), (*qpos.shape[:-1], 3, 3))
    origins, axes = [], []
    for j in range(7):
        position = position + _rotate(rotation, chain.offsets[j])
        rotation = rotation @ chain.rotations[j]
        x, y, axis = rotation[..., 0], rotation[..., 1], rotation[..., 2]
        s, c = sin[..., j, None], cos[..., j, None]
        rotation = jnp.stack([c * x + s * y, c * y - s * x, axis], axis=-1)
        origins.append(position)
        axes.append(axis)
    position = position + _rotate(rotation, chain.offsets[7])
    rotation = rotation @ chain.rotations[7]
    axes, origins = jnp.stack(axes, axis=-2), jnp.stack(origins, axis=-2)
    linear = jnp.cross(axes, position[..., None, :] - origins)
    jacobian = jnp.concatenate([linear, axes], axis=-1).swapaxes(-1, -2)
    return position, rotation, jacobian


def pose(chain: Chain, qpos: jax.Array) -> jax.Array:
    """[..., 6] position (m) and rotation vector (rad) of the tip in the nominal socket's frame."""
    position, rotation, _ = tip_pose(chain, qpos)
    return jnp.concatenate([position, rotation_vector(rotation)], axis=-1)


def rotation_vector(rotation: jax.Array) -> jax.Array:
    """Axis times angle of rotation matrices [..., 3, 3] -> [..., 3] rad; angles below pi."""
    skew = jnp.stack(
        [
            rotation[..., 2, 1] - rotation[..., 1, 2],
            rotation[..., 0, 2] - rotation[..., 2, 0],
            rotation[..., 1, 0] - rotation[..., 0, 1],
        ],
        axis=-1,
    )
    twice_sine = jnp.sqrt(jnp.sum(skew**2, axis=-1) + 1e-14)
    twice_cosine = jnp.trace(rotation, axis1=-2, axis2=-1) - 1.0
    return skew * (jnp.arctan2(twice_sine, twice_cosine) / twice_sine)[..., None]


def rotation_matrix(vector: jax.Array) -> jax.Array:
    """Rotation matrices of axis times angle [..., 3] rad -> [..., 3, 3] (Rodrigues)."""
    angle = jnp.sqrt(jnp.sum(vector**2, axis=-1) + 1e-14)[..., None, None]
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    o = jnp.zeros_like(x)
    cross = jnp.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(*vector.shape[:-1], 3, 3)
    sine, versine = jnp.sin(angle) / angle, (1 - jnp.cos(angle)) / angle**2
    return jnp.eye(3) + sine * cross + versine * (cross @ cross)


HOME = np.array([0.0, 0.2, 0.0, -2.5, 0.0, 2.7, np.pi / 4], np.float32)
"""rad, arm above the socket with the elbow up: start of the inverse kinematics."""
_ITERATIONS = 60
"""They reach 1e-5 m from HOME anywhere in the workspace."""


def inverse_kinematics(
    chain: Chain, position: jax.Array, vector: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Joint angles that bring the tip to a pose, by damped least squares from HOME.

    Args:
      position: [N, 3] m, in the nominal socket's frame.
      vector: [N, 3] rotation vector, rad.

    Returns:
      qpos [N, 7] rad and remaining error [N] (m and rad, root of the sum of squares).
    """
    target = rotation_matrix(vector)
    low, high = chain.limits[:, 0], chain.limits[:, 1]

    def residual(qpos):
        at, rotation, jacobian = tip_pose(chain, qpos)
        turn = rotation_vector(target @ rotation.swapaxes(-1, -2))
        return jnp.concatenate([position - at, turn], axis=-1), jacobian

    def iterate(_, qpos):
        error, jacobian = residual(qpos)
        transposed = jacobian.swapaxes(-1, -2)
        damped = jacobian @ transposed + 1e-4 * jnp.eye(6)
        step = _rotate(transposed, jnp.linalg.solve(damped, error[..., None])[..., 0])
        return jnp.clip(qpos + jnp.clip(step, -0.2, 0.2), low, high)

    start = jnp.broadcast_to(HOME, (*position.shape[:-1], 7))
    qpos = jax.lax.fori_loop(0, _ITERATIONS, iterate, start)
    return qpos, jnp.linalg.norm(residual(qpos)[0], axis=-1)


def _rotate(matrix, vector):
    return jnp.einsum("...ij,...j->...i", matrix, vector)
