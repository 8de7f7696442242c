"""Evaluation counts every episode once, from a fresh start to its end."""

import jax
import jax.numpy as jnp
import numpy as np
import probe_env
import pytest

from crsfd_jax import evaluation
from crsfd_jax.env import Env
from crsfd_jax.learn.networks import Networks
from crsfd_jax.observation import ACTION_SIZE


def always(value: float) -> Networks:
    """A policy whose every action is about tanh(value)."""

    class Constant:
        action_size = ACTION_SIZE

        def apply(self, params, obs):
            mean = jnp.full((*obs.shape[:-1], ACTION_SIZE), value)
            return mean, jnp.zeros_like(mean)

    return Networks(actor=Constant(), critic=None)  # pyright: ignore[reportArgumentType]


def played(env: Env, value: float) -> evaluation.Episodes:
    return evaluation.run(env, always(value), {}, jax.random.key(0), 20)


def test_success_ends_an_episode_and_counts_once():
    episodes = played(probe_env.make(), 1.0)
    assert np.asarray(episodes.success).all()
    assert (np.asarray(episodes.length) == 1).all()


def test_an_episode_without_success_lasts_until_the_limit():
    episodes = played(probe_env.make(), -1.0)
    assert not np.asarray(episodes.success).any()
    assert (np.asarray(episodes.length) == probe_env.HORIZON).all()


@pytest.mark.parametrize("breaks_at", [0.3, 0.8])
def test_a_broken_simulation_is_a_failure(breaks_at):
    episodes = played(probe_env.make(breaks_at=breaks_at), 1.0)
    share = np.asarray(episodes.success).mean()
    assert abs(share - breaks_at) < 0.3 and share < 1.0
    assert (np.asarray(episodes.length) == 1).all()


def waits_by_draw() -> Networks:
    """A policy that acts on the step that the second entry of the observation, in [0, 1], says."""

    class Waiting:
        action_size = ACTION_SIZE

        def apply(self, params, obs):
            due = obs[..., 0] >= jnp.floor(obs[..., 1] * HALF)
            mean = jnp.where(due, 1.0, -1.0)[..., None] * jnp.ones(ACTION_SIZE)
            return mean, jnp.zeros_like(mean)

    return Networks(actor=Waiting(), critic=None)  # pyright: ignore[reportArgumentType]


HALF = probe_env.HORIZON // 2


def test_what_follows_the_end_of_an_episode_is_not_counted():
    """Environments end one after the other, and go on with others while the last still runs."""
    key, count = jax.random.key(3), 200
    draw = np.asarray(probe_env.make().reset(jax.random.split(key)[0], count).obs[:, 1])
    episodes = evaluation.run(probe_env.make(), waits_by_draw(), {}, key, count)
    assert len(np.unique(np.floor(draw * HALF))) == HALF
    np.testing.assert_array_equal(episodes.length, np.floor(draw * HALF) + 1)
    assert np.asarray(episodes.success).all()
    # One that broke down at its first step may succeed after its reset: that is another episode.
    broken = evaluation.run(probe_env.make(breaks_at=0.5), waits_by_draw(), {}, key, count)
    np.testing.assert_array_equal(broken.success, draw <= 0.5)
    np.testing.assert_array_equal(broken.length[draw > 0.5], 1)
