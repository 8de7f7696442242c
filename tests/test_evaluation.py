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
