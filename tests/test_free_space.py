"""Poses drawn in free space are poses that the arm can have, above the mouth."""

import jax
import numpy as np
import pytest

from crsfd_jax import free_space
from crsfd_jax.observation import POSE_SCALE
from crsfd_jax.scene import kinematics

COUNT = 2000


@pytest.fixture(scope="module")
def sample(scene):
    return free_space.make(scene, extent=1.0)


@pytest.fixture(scope="module")
def poses(sample):
    return np.asarray(sample(jax.random.key(0), COUNT))


@pytest.fixture(scope="module")
def far_poses(scene):
    return np.asarray(free_space.make(scene, extent=3.0, seed=1)(jax.random.key(0), COUNT))


def test_samples_are_above_the_mouth_and_as_far_as_the_extent_says(poses):
    position = poses[:, :3] * 0.03
    assert position[:, 2].min() > -1e-4
    np.testing.assert_allclose(position.min(axis=0), [-0.05, -0.05, 0.0], atol=1e-3)
    np.testing.assert_allclose(position.max(axis=0), [0.05, 0.05, 0.05], atol=1e-3)
    np.testing.assert_allclose(position.mean(axis=0), [0, 0, 0.025], atol=2e-3)
    assert 0.149 < np.abs(poses[:, 3:] * 0.1).max() < 0.151


def test_the_arm_reaches_the_samples_even_far_out(links, far_poses):
    far = far_poses * POSE_SCALE
    _, error = jax.jit(kinematics.inverse_kinematics)(links, far[:, :3], far[:, 3:])
    assert error.max() < 0.03 and np.abs(far[:, 0]).max() > 0.12


def test_samples_follow_their_key_and_the_pool_its_seed(sample, poses, far_poses):
    np.testing.assert_array_equal(sample(jax.random.key(0), COUNT), poses)
    assert not np.array_equal(sample(jax.random.key(1), COUNT), poses)
    assert not np.allclose(far_poses[:, :3] / 3, poses[:, :3], atol=0.1)
    assert np.isfinite(poses).all() and poses.shape == (COUNT, 6)


def test_the_pool_is_solved_once_and_only_if_it_is_used(scene, monkeypatch):
    solved, solve = [], free_space._poses

    def counted(*arguments):
        solved.append(free_space._POOL)
        return solve(*arguments)

    monkeypatch.setattr(free_space, "_poses", counted)
    monkeypatch.setattr(free_space, "_POOL", 64)
    sample = free_space.make(scene, extent=1.0)
    assert solved == []
    inside = jax.jit(lambda key: sample(key, 5))(jax.random.key(0))
    np.testing.assert_array_equal(sample(jax.random.key(0), 5), inside)
    assert solved == [64]
