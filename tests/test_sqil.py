"""SQIL's constants, its halves and its absorbing success state, by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import probe_env
import pytest
from test_train_step import learner_and_states

from crsfd_jax import algorithms
from crsfd_jax.config import Config, Replay, Sac
from crsfd_jax.learn import replay
from crsfd_jax.training import chunk

GAMMA = 0.9
CONFIG = Config(sac=Sac(gamma=GAMMA), replay=Replay(capacity=8, n_step=3))
SQIL = algorithms.load("sqil")


def buffer(experience_reward=0.0):
    """Demonstrations in rows 0..5, success in 1, 3, 5; experience in rows 6..13, success in 13."""
    demos = probe_env.preparation(6).demos
    state = replay.init(demos, 4, CONFIG.replay)
    for step, ends in enumerate((jnp.zeros(4, bool), jnp.arange(4) == 3)):
        new = jax.tree.map(lambda leaf: leaf[:4], demos)
        new = new.replace(terminated=ends, reward=jnp.full(4, experience_reward))
        state = replay.add(state, new, jnp.ones(4, bool), step)
    return state


def batch_of(row_numbers, state):
    window, alive = replay.follow(state, jnp.int32(1), jnp.asarray(row_numbers), 3)
    draw = replay.Draw(rows=window, alive=alive, weight=jnp.ones(len(row_numbers)))
    rewards = SQIL.relabel((), state, draw, CONFIG)
    return rewards, replay.gather(state, draw, rewards, GAMMA)


def test_a_step_pays_one_minus_gamma_on_demonstrations_and_nothing_on_experience():
    rewards, _ = batch_of([0, 2, 6, 7], buffer())
    np.testing.assert_allclose(rewards[:, 0], [0.1, 0.1, 0.0, 0.0], rtol=1e-6)


def test_the_reward_of_the_task_is_never_read():
    plain, _ = batch_of(range(14), buffer())
    paid, _ = batch_of(range(14), buffer(experience_reward=5.0))
    np.testing.assert_array_equal(plain, paid)


def test_an_end_is_worth_what_the_absorbing_state_pays_for_ever():
    """sum_k gamma^k (1 - gamma) = 1 from a demonstrated end, one step of it less from any other."""
    _, batch = batch_of([0, 1, 12, 13, 9], buffer())
    for_ever = sum(GAMMA**k * (1 - GAMMA) for k in range(1, 500))
    np.testing.assert_allclose(
        batch.one_step.reward, [0.1, 0.1 + for_ever, 0.0, for_ever, 0.0], rtol=1e-5
    )
    np.testing.assert_array_equal(batch.one_step.terminated, [False, True, False, True, False])
    np.testing.assert_allclose(batch.n_step.reward[0], 1.0, rtol=1e-5)
    np.testing.assert_allclose(batch.n_step.reward[4], GAMMA * for_ever, rtol=1e-5)


def test_half_of_a_batch_is_demonstrated_and_values_stay_between_zero_and_one():
    sac = Sac(
        hidden=(16, 16),
        reward_scale=1.0,
        batch_size=32,
        updates_per_step=8,
        warmup_steps=0,
        learning_rate=3e-3,
        tau=0.05,
        initial_alpha=1e-4,
        target_entropy=-30.0,
    )
    learner, states = learner_and_states(probe_env.config(algorithm="sqil", sac=sac))
    states, metrics = chunk.make(learner, 150)(states, jnp.int32(0))
    np.testing.assert_allclose(metrics["demo_share"], 0.5, rtol=1e-6)
    batch = states.replay.storage
    nets = learner.nets
    q = jax.vmap(lambda params, rows: nets.critic.apply(params, rows.obs, rows.action))(
        states.agent.critic, jax.tree.map(lambda leaf: leaf[:, :6], batch)
    )
    assert q.min() > -0.1 and q.max() < 1.1
    assert np.asarray(q)[..., 1::2].mean() == pytest.approx(1.0, abs=0.1)
