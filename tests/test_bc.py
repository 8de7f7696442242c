"""Behaviour cloning recovers the policy that was demonstrated, and nothing else learns."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import probe_env
from test_train_step import learner_and_states

from crsfd_jax import algorithms
from crsfd_jax.algorithms import bc
from crsfd_jax.config import Sac
from crsfd_jax.learn import networks
from crsfd_jax.learn.replay import Backup, Batch
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.training import chunk, train_step
from crsfd_jax.types import Transition

NETS = networks.make_networks(Sac(hidden=(16, 16)), ACTION_SIZE)


def linear_demos(key, count):
    """States at random, actions tanh(M s) with a fixed M."""
    matrix = 0.5 * jax.random.normal(jax.random.key(99), (OBS_SIZE, ACTION_SIZE))
    obs = jax.random.normal(key, (count, OBS_SIZE)) / 3
    nothing = jnp.zeros(count, bool)
    return Transition(
        obs=obs,
        action=jnp.tanh(obs @ matrix),
        reward=jnp.zeros(count),
        next_obs=obs,
        terminated=nothing,
        truncated=nothing,
    )


def test_a_linear_policy_is_recovered():
    sac = Sac(hidden=(64,), batch_size=64, updates_per_step=50, learning_rate=3e-3, warmup_steps=0)
    config = probe_env.config(algorithm="bc", sac=sac)
    learner = train_step.make(probe_env.make(), algorithms.load("bc"), config)
    demos = linear_demos(jax.random.key(0), 2000)
    preparation = probe_env.preparation()._replace(demos=demos)
    states = jax.vmap(lambda key: learner.init(key, preparation))(
        jax.random.split(jax.random.key(1), 1)
    )
    states, metrics = chunk.make(learner, 40)(states, jnp.int32(0))
    actor = jax.tree.map(lambda leaf: leaf[0], states.agent.actor)
    fresh = linear_demos(jax.random.key(2), 500)
    error = networks.mode_action(learner.nets.actor, actor, fresh.obs) - fresh.action
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.std(fresh.action)
    assert (np.asarray(metrics["demo_share"]) == 1).all()


def test_the_loss_is_the_squared_error_of_the_deterministic_action():
    demos = linear_demos(jax.random.key(3), 9)
    actor = NETS.actor.init(jax.random.key(0), demos.obs[0])
    step = Backup(
        reward=demos.reward,
        next_obs=demos.obs,
        terminated=demos.terminated,
        length=jnp.ones(9, jnp.int32),
    )
    batch = Batch(
        obs=demos.obs,
        action=demos.action,
        weight=jnp.ones(9),
        one_step=step,
        n_step=step,
    )
    mean, _ = NETS.actor.apply(actor, demos.obs)
    square = (np.tanh(mean) - np.asarray(demos.action)) ** 2
    loss, error = bc.regression_loss(actor, NETS, batch)
    np.testing.assert_allclose(loss, square.mean(), rtol=1e-5)
    np.testing.assert_allclose(error, np.sqrt(square.mean(axis=1)), rtol=1e-5)


def test_critics_and_temperature_stay_and_the_task_is_never_met():
    learner, states = learner_and_states(probe_env.config(algorithm="bc"))
    before = jax.tree.map(np.asarray, states.agent)
    env = jax.tree.map(np.asarray, states.env)
    states, metrics = chunk.make(learner, 12)(states, jnp.int32(0))
    same = jax.tree.map(np.array_equal, before, states.agent)
    assert all(jax.tree.leaves((same.critic, same.log_alpha)))
    assert not all(jax.tree.leaves(same.actor))
    jax.tree.map(np.testing.assert_array_equal, env, states.env)
    assert (np.asarray(states.replay.priority)[:, 6:] == 0).all()
    assert "episodes" not in metrics


def test_no_memory_is_spent_on_experience():
    config = probe_env.config(algorithm="bc")
    assert bc.configure(config).replay == dataclasses.replace(config.replay, capacity=config.envs)
