"""The arm's kinematics in JAX against MuJoCo's, and the inverse against the forward."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from crsfd_jax.scene import kinematics


def mujoco_tip(scene, qpos):
    """Position relative to the nominal socket, rotation and Jacobian of the tip, float64."""
    data = mujoco.MjData(scene.model)
    data.qpos[:] = qpos
    mujoco.mj_forward(scene.model, data)
    linear, angular = np.zeros((3, 7)), np.zeros((3, 7))
    mujoco.mj_jacSite(scene.model, data, linear, angular, scene.tip_site)
    site = data.site("tip")
    return site.xpos - scene.nominal, site.xmat.reshape(3, 3), np.vstack([linear, angular])


def test_pose_and_jacobian_of_the_tip_are_those_of_mujoco(scene, links):
    low, high = links.limits.T
    joints = np.random.default_rng(0).uniform(low, high, (50, 7)).astype(np.float32)
    position, rotation, jacobian = jax.jit(lambda q: kinematics.tip_pose(links, q))(joints)
    for i, qpos in enumerate(joints):
        expected = mujoco_tip(scene, qpos)
        for got, want in zip((position[i], rotation[i], jacobian[i]), expected, strict=True):
            np.testing.assert_allclose(got, want, atol=3e-6)


def test_leading_axes_are_free(links):
    joints = np.random.default_rng(1).normal(size=(2, 3, 7)).astype(np.float32)
    stacked = kinematics.tip_pose(links, joints)
    for got, want in zip(stacked, kinematics.tip_pose(links, joints[1, 2]), strict=True):
        np.testing.assert_allclose(got[1, 2], want, atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-3, 0.15, 1.0, 3.0])
def test_rotation_vectors_and_matrices_are_those_of_mujoco(angle):
    axes = np.random.default_rng(2).normal(size=(20, 3))
    vectors = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    matrices = kinematics.rotation_matrix(jnp.asarray(vectors, jnp.float32))
    for vector, matrix in zip(vectors, matrices, strict=True):
        quaternion, expected = np.zeros(4), np.zeros(9)
        mujoco.mju_axisAngle2Quat(quaternion, vector / max(angle, 1e-30), angle)
        mujoco.mju_quat2Mat(expected, quaternion)
        np.testing.assert_allclose(matrix, expected.reshape(3, 3), atol=1e-6)
    # Near half a turn the sine that carries the axis is small, and float32 shows.
    np.testing.assert_allclose(kinematics.rotation_vector(matrices), vectors, atol=1e-5)


def test_rotations_have_finite_derivatives_at_zero():
    def there_and_back(vector):
        return kinematics.rotation_vector(kinematics.rotation_matrix(vector))

    np.testing.assert_allclose(jax.jacobian(there_and_back)(jnp.zeros(3)), np.eye(3), atol=1e-3)


def test_inverse_kinematics_reaches_the_workspace(links, at_rest):
    rng = np.random.default_rng(3)
    position = rng.uniform([-0.04, -0.04, -0.03], [0.04, 0.04, 0.08], (200, 3))
    vector = rng.uniform(-0.15, 0.15, (200, 3))
    qpos = at_rest(position, vector).qpos
    reached, rotation, _ = kinematics.tip_pose(links, qpos)
    np.testing.assert_allclose(reached, position, atol=1e-5)
    np.testing.assert_allclose(kinematics.rotation_vector(rotation), vector, atol=1e-4)
    assert (qpos > links.limits[:, 0]).all() and (qpos < links.limits[:, 1]).all()


def test_a_pose_out_of_reach_gives_allowed_joints_and_an_honest_error(links):
    far = jnp.array([[2.0, 0.0, 0.0]])
    qpos, error = kinematics.inverse_kinematics(links, far, jnp.zeros((1, 3)))
    assert (qpos >= links.limits[:, 0]).all() and (qpos <= links.limits[:, 1]).all()
    position, rotation, _ = kinematics.tip_pose(links, qpos)
    turn = kinematics.rotation_vector(rotation)
    left = np.concatenate([far - position, -turn], axis=-1)
    np.testing.assert_allclose(error, np.linalg.norm(left, axis=-1), rtol=1e-3)
    assert error[0] > 0.5
