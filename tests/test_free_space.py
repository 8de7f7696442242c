"""States drawn in free space are states that the arm can be in, above the mouth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from crsfd_jax import env, free_space, observation
from crsfd_jax.scene import kinematics

COUNT = 2000


@pytest.fixture(scope="module")
def sample(scene):
    return free_space.make(scene, extent=1.0)


@pytest.fixture(scope="module")
def obs(sample):
    return sample(jax.random.key(0), COUNT)


def whole(obs):
    """Rows in which nothing was clipped, and which tell their state completely."""
    rows = np.asarray(obs)
    return jnp.asarray(rows[np.abs(rows).max(axis=1) < 10])


def test_pose_and_velocity_belong_to_the_joints_of_the_same_observation(links, obs):
    kept = whole(obs)
    assert len(kept) > 0.9 * COUNT
    qpos = kept[:, :7] * 0.1 + env.rest_posture(links)
    position, rotation, jacobian = jax.jit(lambda q: kinematics.tip_pose(links, q))(qpos)
    np.testing.assert_allclose(kept[:, 14:17] * 0.03, position, atol=5e-6)
    vector = kinematics.rotation_vector(rotation)
    np.testing.assert_allclose(kept[:, 17:20] * 0.1, vector, atol=2e-5)
    twist = np.einsum("nij,nj->ni", jacobian, kept[:, 7:14] * 0.5)
    np.testing.assert_allclose(kept[:, 20:23] * 0.1, twist[:, :3], atol=1e-5)
    np.testing.assert_allclose(kept[:, 23:26] * 0.5, twist[:, 3:], atol=1e-5)


def test_samples_are_above_the_mouth_and_as_far_as_the_extent_says(obs):
    position = np.asarray(obs[:, 14:17]) * 0.03
    assert position[:, 2].min() > -1e-4
    np.testing.assert_allclose(position.min(axis=0), [-0.05, -0.05, 0.0], atol=1e-3)
    np.testing.assert_allclose(position.max(axis=0), [0.05, 0.05, 0.05], atol=1e-3)
    np.testing.assert_allclose(position.mean(axis=0), [0, 0, 0.025], atol=2e-3)
    assert np.abs(obs[:, 17:20] * 0.1).max() < 0.151


@pytest.fixture(scope="module")
def far_obs(scene):
    return free_space.make(scene, extent=3.0, seed=1)(jax.random.key(0), COUNT)


def test_joints_keep_their_limits_even_far_out(links, far_obs):
    far = whole(far_obs)
    qpos = far[:, :7] * 0.1 + env.rest_posture(links)
    assert (qpos > links.limits[:, 0] - 1e-4).all() and (qpos < links.limits[:, 1] + 1e-4).all()
    assert np.abs(far[:, 14] * 0.03).max() > 0.12


def test_samples_follow_their_key_and_the_pool_its_seed(sample, obs, far_obs):
    np.testing.assert_array_equal(sample(jax.random.key(0), COUNT), obs)
    assert not np.array_equal(sample(jax.random.key(1), COUNT), obs)
    assert not np.allclose(far_obs[:, 14:17] / 3, obs[:, 14:17], atol=0.1)
    assert np.isfinite(obs).all() and obs.shape == (COUNT, observation.OBS_SIZE)
