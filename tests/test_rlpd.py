"""RLPD's target and actor objective, against numpy over the critics of the ensemble."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import probe_env
import pytest
from test_train_step import learner_and_states

from crsfd_jax import algorithms
from crsfd_jax.algorithms import rlpd
from crsfd_jax.config import Config, Sac
from crsfd_jax.learn import networks, sac
from crsfd_jax.learn.replay import Backup, Batch
from crsfd_jax.training import chunk

OBS, ACTION, BATCH = 5, 2, 7
CONFIG = rlpd.configure(Config(sac=Sac(hidden=(8, 8), gamma=0.9, initial_alpha=0.3)))
NETS = networks.make_networks(CONFIG.sac, ACTION)
RLPD = algorithms.load("rlpd")


@pytest.fixture(name="agent", scope="module")
def make_agent():
    agent, other = (sac.init(NETS, OBS, jax.random.key(i), CONFIG) for i in (0, 1))
    return dataclasses.replace(agent, target_critic=other.critic)


def values(agent, obs, action):
    """[10, B] of the target critics."""
    return np.asarray(NETS.critic.apply(agent.target_critic, obs, action))


def test_the_target_is_the_smaller_value_of_a_random_pair_without_entropy(agent):
    obs = jax.random.normal(jax.random.key(2), (BATCH, OBS))
    pairs = set()
    for seed in range(40):
        key = jax.random.key(seed)
        action_key, _ = jax.random.split(key)
        action, _ = networks.sample_action(NETS.actor, agent.actor, obs, action_key)
        q = values(agent, obs, action)
        actual = np.asarray(rlpd.subset_value(NETS, agent, obs, key))
        fits = [
            (i, j)
            for i in range(10)
            for j in range(i)
            if np.allclose(np.minimum(q[i], q[j]), actual, rtol=1e-4, atol=1e-5)
        ]
        assert fits, "no pair of critics explains the target"
        pairs.add(fits[0])
    assert len(pairs) > 15
    assert {member for pair in pairs for member in pair} == set(range(10))


def test_the_subset_is_one_for_the_whole_batch_and_its_members_differ(agent):
    """With constant critics 0..9 the target says which pair was drawn."""
    params = jax.tree.map(jnp.zeros_like, agent.target_critic)
    biases = params["params"]["VmapQFunction_0"]["Dense_2"]
    biases["bias"] = jnp.arange(10.0)[:, None]
    constant = dataclasses.replace(agent, target_critic=params)
    obs = jnp.zeros((2, BATCH, OBS))
    drawn = jax.jit(jax.vmap(lambda key: rlpd.subset_value(NETS, constant, obs, key)))(
        jax.random.split(jax.random.key(0), 3000)
    )
    drawn = np.asarray(drawn).reshape(3000, -1)
    assert (drawn == drawn[:, :1]).all()
    # The smaller of two different members of ten is m with probability (9 - m) / 45.
    frequency = np.bincount(drawn[:, 0].astype(int), minlength=10) / 3000
    np.testing.assert_allclose(frequency, (9 - np.arange(10)) / 45, atol=0.03)


def random_batch():
    keys = jax.random.split(jax.random.key(3), 4)
    step = Backup(
        reward=jax.random.normal(keys[0], (BATCH,)),
        next_obs=jax.random.normal(keys[1], (BATCH, OBS)),
        terminated=jnp.arange(BATCH) % 3 == 0,
        length=jnp.ones(BATCH, jnp.int32),
    )
    return Batch(
        obs=jax.random.normal(keys[2], (BATCH, OBS)),
        action=jax.random.uniform(keys[3], (BATCH, ACTION), minval=-1.0),
        weight=jnp.ones(BATCH),
        one_step=step,
        n_step=step,
    )


def test_the_actor_raises_the_mean_of_all_critics(agent):
    """The loss that an update reports, recomputed in numpy at the same parameters."""
    batch, key = random_batch(), jax.random.key(4)
    _, _, metrics = jax.jit(RLPD.update, static_argnums=(0, 4))(NETS, agent, batch, key, CONFIG)
    _, actor_key = jax.random.split(key)
    action, log_prob = networks.sample_action(NETS.actor, agent.actor, batch.obs, actor_key)
    q = np.asarray(NETS.critic.apply(agent.critic, batch.obs, action))
    expected = np.mean(0.3 * np.asarray(log_prob) - q.mean(axis=0))
    assert metrics["actor_loss"] == pytest.approx(expected, rel=1e-4)


def test_the_critics_are_fitted_to_the_target_of_the_pair(agent):
    batch, key = random_batch(), jax.random.key(4)
    _, td_error, _ = jax.jit(RLPD.update, static_argnums=(0, 4))(NETS, agent, batch, key, CONFIG)
    target_key, _ = jax.random.split(key)
    step = batch.one_step
    # The 1-step and the n-step backup share one draw of the pair and of the actions.
    after = rlpd.subset_value(NETS, agent, jnp.stack([step.next_obs] * 2), target_key)[0]
    target = step.reward + 0.9 * np.where(step.terminated, 0.0, after)
    q = np.asarray(NETS.critic.apply(agent.critic, batch.obs, batch.action))
    np.testing.assert_allclose(td_error, np.abs(q - target).mean(axis=0), rtol=1e-4)


def test_half_of_what_is_learned_from_is_demonstrated_and_ten_critics_learn():
    learner, states = learner_and_states(probe_env.config(algorithm="rlpd"))
    before = jax.tree.map(np.asarray, states.agent.critic)
    advance = chunk.make(learner, 8)
    states, _ = advance(states, jnp.int32(0))
    states, metrics = advance(states, jnp.int32(8))
    np.testing.assert_allclose(metrics["demo_share"], 0.5)
    for old, new in zip(jax.tree.leaves(before), jax.tree.leaves(states.agent.critic), strict=True):
        assert old.shape[1] == 10
        assert (np.abs(new - old).reshape(3, 10, -1).max(axis=-1) > 0).all()
