"""Soft actor-critic losses and the update, against numpy and finite differences."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import random_batch
from random_batch import BATCH

from crsfd_jax.config import Config, Replay, Sac
from crsfd_jax.learn import networks, sac
from crsfd_jax.learn.replay import Backup, Batch

OBS, ACTION = 5, 2
CONFIG = Config(
    sac=Sac(hidden=(8, 8), gamma=0.9, tau=0.25, initial_alpha=0.3, target_entropy=-1.0),
    replay=Replay(n_step_weight=0.5),
)
NETWORKS = networks.make_networks(CONFIG.sac, ACTION)
UPDATE = jax.jit(sac.update, static_argnums=(0, 4))
INIT = jax.jit(lambda key: sac.init(NETWORKS, OBS, key, CONFIG))


@pytest.fixture(name="batch", scope="module")
def make_batch() -> Batch:
    return random_batch.batch(OBS, ACTION)


@pytest.fixture(name="agent", scope="module")
def make_agent() -> sac.AgentState:
    agent = INIT(jax.random.key(0))
    # A target that differs from the critic shows which of the two is used.
    other = INIT(jax.random.key(9))
    return dataclasses.replace(agent, target_critic=other.critic)


def test_targets_equal_those_computed_by_hand(agent, batch):
    key = jax.random.key(4)
    targets = sac.bootstrap_targets(NETWORKS, agent, batch.n_step, 0.9, key, sac.soft_value)
    action, log_prob = networks.sample_action(
        NETWORKS.actor, agent.actor, batch.n_step.next_obs, key
    )
    q = NETWORKS.critic.apply(agent.target_critic, batch.n_step.next_obs, action)
    for i in range(BATCH):
        value = min(q[0, i], q[1, i]) - 0.3 * log_prob[i]
        goes_on = 0.0 if batch.n_step.terminated[i] else 1.0
        expected = batch.n_step.reward[i] + 0.9 ** int(batch.n_step.length[i]) * goes_on * value
        assert targets[i] == pytest.approx(float(expected), rel=1e-5)


def test_a_terminal_step_does_not_bootstrap_and_any_other_does(agent):
    ended = random_batch.backup(jax.random.key(2), OBS, terminated=jnp.ones(BATCH, bool))
    going = dataclasses.replace(ended, terminated=jnp.zeros(BATCH, bool))
    on_end, on_going = (
        sac.bootstrap_targets(NETWORKS, agent, b, 0.9, jax.random.key(3), sac.soft_value)
        for b in (ended, going)
    )
    np.testing.assert_array_equal(on_end, ended.reward)
    assert (np.abs(on_going - going.reward) > 1e-4).all()


def test_a_terminal_step_ignores_a_next_obs_that_is_not_finite(agent):
    ended = random_batch.backup(jax.random.key(2), OBS, terminated=jnp.ones(BATCH, bool))
    ended = dataclasses.replace(ended, next_obs=jnp.full((BATCH, OBS), jnp.nan))
    targets = sac.bootstrap_targets(NETWORKS, agent, ended, 0.9, jax.random.key(3), sac.soft_value)
    np.testing.assert_array_equal(targets, ended.reward)


def test_critic_loss_equals_the_one_computed_in_numpy(agent, batch):
    targets = jax.random.normal(jax.random.key(5), (2, BATCH))
    loss, (td_error, _) = sac.critic_loss(
        agent.critic, NETWORKS, batch, targets, jnp.asarray([1.0, 0.5])
    )
    q = np.asarray(NETWORKS.critic.apply(agent.critic, batch.obs, batch.action), np.float64)
    expected = 0.0
    for j in range(2):
        for i in range(BATCH):
            squares = (q[j, i] - targets[0, i]) ** 2 + 0.5 * (q[j, i] - targets[1, i]) ** 2
            expected += batch.weight[i] * squares / BATCH
    assert loss == pytest.approx(float(expected), rel=1e-5)
    np.testing.assert_allclose(td_error, np.abs(q - targets[0]).mean(axis=0), rtol=1e-5)


def test_actor_loss_equals_the_one_computed_in_numpy(agent, batch):
    key = jax.random.key(6)
    loss, log_prob = sac.actor_loss(agent.actor, NETWORKS, agent, batch, key, jnp.min)
    action, expected_log_prob = networks.sample_action(NETWORKS.actor, agent.actor, batch.obs, key)
    q = np.asarray(NETWORKS.critic.apply(agent.critic, batch.obs, action))
    terms = np.asarray(batch.weight) * (0.3 * np.asarray(expected_log_prob) - q.min(axis=0))
    assert loss == pytest.approx(terms.mean(), rel=1e-5)
    np.testing.assert_allclose(log_prob, expected_log_prob, rtol=1e-6)


@pytest.mark.parametrize(("entropy", "sign"), [(2.0, 1.0), (-4.0, -1.0)])
def test_alpha_falls_when_the_entropy_is_above_its_target_and_rises_below(entropy, sign):
    log_prob = jnp.asarray([-entropy - 0.5, -entropy + 0.5])
    loss, slope = jax.value_and_grad(sac.temperature_loss)(jnp.log(0.3), log_prob, -1.0)
    assert loss == pytest.approx(-0.3 * (-entropy - 1.0), rel=1e-5)
    assert slope == pytest.approx(0.3 * (entropy + 1.0), rel=1e-5)
    assert np.sign(slope) == sign


def test_gradients_agree_with_finite_differences_in_float64(agent, batch):
    with jax.enable_x64(True):
        wide = jax.tree.map(
            lambda x: x.astype(jnp.float64) if x.dtype == jnp.float32 else x, (agent, batch)
        )
        agent, batch = wide
        targets = jnp.asarray(np.random.default_rng(0).normal(size=(2, BATCH)))

        def critic(params):
            return sac.critic_loss(params, NETWORKS, batch, targets, jnp.asarray([1.0, 0.5]))[0]

        def actor(params):
            return sac.actor_loss(params, NETWORKS, agent, batch, jax.random.key(6), jnp.min)[0]

        for loss, params in ((critic, agent.critic), (actor, agent.actor)):
            check_slope(loss, params)


def check_slope(loss, params):
    rng = np.random.default_rng(1)
    direction = jax.tree.map(lambda x: rng.normal(size=x.shape), params)

    @jax.jit
    def slopes(params):
        gradient = jax.grad(loss)(params)
        along = sum(jax.tree.leaves(jax.tree.map(jnp.vdot, gradient, direction)))
        ahead, behind = (
            loss(jax.tree.map(lambda x, d, s=s: x + s * d, params, direction))
            for s in (1e-6, -1e-6)
        )
        return along, (ahead - behind) / 2e-6

    along, difference = slopes(params)
    assert along == pytest.approx(float(difference), rel=1e-5)


@pytest.mark.parametrize("tau", [0.0, 0.25, 1.0])
def test_target_critic_moves_towards_the_new_critic_by_tau(agent, tau):
    config = dataclasses.replace(CONFIG, sac=dataclasses.replace(CONFIG.sac, tau=tau))
    gradients = (agent.actor, agent.critic, agent.log_alpha)
    new = jax.jit(sac.apply_gradients, static_argnums=2)(agent, gradients, config)
    leaves = (jax.tree.leaves(x) for x in (new.target_critic, agent.target_critic, new.critic))
    for moved, target, critic in zip(*leaves, strict=True):
        np.testing.assert_allclose(moved, (1 - tau) * target + tau * critic, atol=1e-6)


def test_the_averaged_actor_follows_the_actor_and_nothing_follows_it(agent, batch):
    """Over three updates; with a rate of 1 it is the actor."""
    found = {}
    for rate in (0.25, 1.0):
        config = dataclasses.replace(CONFIG, sac=dataclasses.replace(CONFIG.sac, actor_tau=rate))
        state, expected = agent, agent.actor
        for i in range(3):
            state, _, _ = UPDATE(NETWORKS, state, batch, jax.random.key(i), config)
            expected = jax.tree.map(
                lambda old, new, rate=rate: (1 - rate) * old + rate * new, expected, state.actor
            )
        jax.tree.map(
            lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), state.average_actor, expected
        )
        found[rate] = state.replace(average_actor=())
    jax.tree.map(np.testing.assert_array_equal, found[0.25], found[1.0])
    jax.tree.map(np.testing.assert_array_equal, state.average_actor, state.actor)


def test_first_step_moves_every_parameter_by_the_learning_rate_against_its_gradient(agent, batch):
    new, _, _ = UPDATE(NETWORKS, agent, batch, jax.random.key(8), CONFIG)
    for old, moved in ((agent.actor, new.actor), (agent.critic, new.critic)):
        for a, b in zip(jax.tree.leaves(old), jax.tree.leaves(moved), strict=True):
            assert np.abs(b - a).max() == pytest.approx(CONFIG.sac.learning_rate, rel=0.02)
    assert abs(new.log_alpha - agent.log_alpha) == pytest.approx(5e-4, rel=0.02)


def test_n_step_weight_zero_ignores_the_n_step_target(agent, batch):
    config = dataclasses.replace(CONFIG, replay=Replay(n_step_weight=0.0))
    broken = dataclasses.replace(batch, n_step=jax.tree.map(lambda x: x * jnp.nan, batch.n_step))
    new, td_error, metrics = UPDATE(NETWORKS, agent, broken, jax.random.key(8), config)
    assert np.isfinite(td_error).all() and np.isfinite(metrics["critic_loss"])
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(new.critic))


def test_a_seed_alone_equals_the_same_seed_among_others(batch):
    keys = jax.random.split(jax.random.key(3), 3)
    agents = jax.vmap(INIT)(keys)
    together = jax.jit(
        jax.vmap(lambda agent, key: sac.update(NETWORKS, agent, batch, key, CONFIG))
    )(agents, keys)
    for seed in range(3):
        agent = INIT(keys[seed])
        alone = UPDATE(NETWORKS, agent, batch, keys[seed], CONFIG)
        jax.tree.map(
            lambda a, b, seed=seed: np.testing.assert_allclose(a, b[seed], rtol=1e-5, atol=1e-5),
            alone,
            together,
        )


def test_critic_learns_the_value_of_a_loop_with_a_known_reward():
    """One state, reward 1 for ever, no entropy: Q = 1 / (1 - gamma)."""
    config = Config(
        sac=Sac(
            hidden=(16, 16),
            gamma=0.5,
            tau=0.2,
            learning_rate=5e-3,
            initial_alpha=1e-6,
            target_entropy=-50.0,
        ),
        replay=Replay(n_step_weight=1.0),
    )
    nets = networks.make_networks(config.sac, ACTION)
    obs = jnp.ones((32, OBS))
    ones = jnp.ones(32)
    one_step = Backup(
        reward=ones, next_obs=obs, terminated=ones < 0, length=jnp.ones(32, jnp.int32)
    )
    three_step = dataclasses.replace(one_step, reward=1.75 * ones, length=3 * one_step.length)

    def body(agent, key):
        action = jax.random.uniform(key, (32, ACTION), minval=-1.0)
        batch = Batch(
            obs=obs,
            action=action,
            weight=ones,
            one_step=one_step,
            n_step=three_step,
        )
        agent, _, metrics = sac.update(nets, agent, batch, key, config)
        return agent, metrics["q"]

    agent = sac.init(nets, OBS, jax.random.key(0), config)
    _, q = jax.jit(lambda a: jax.lax.scan(body, a, jax.random.split(jax.random.key(1), 600)))(agent)
    assert q[-1] == pytest.approx(2.0, abs=0.05)
