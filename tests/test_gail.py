"""GAIL, GAIfO and POfD: what they pay for, with which discriminator, and that it teaches."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import probe_env
import pytest

from crsfd_jax import algorithms
from crsfd_jax.algorithms import gail, pofd
from crsfd_jax.learn import replay
from crsfd_jax.learn.replay import Draw, ReplayState
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.training import train_step
from crsfd_jax.types import Transition

STEPS = 6
CONFIG = probe_env.config(algorithm="gail")
PREPARATION = probe_env.preparation()
EVERY_ROW = Draw(
    rows=jnp.arange(24).reshape(1, 8, 3), alive=jnp.ones((1, 8, 3), bool), weight=jnp.ones((1, 8))
)


def softplus(x):
    return np.log1p(np.exp(x))


def experience(successes=1, demos=0) -> ReplayState:
    """24 rows far from the demonstrations, behind some of them; the first of some steps succeed."""
    pinned = jax.tree.map(lambda x: x[:demos], PREPARATION.demos)
    buffer = replay.init(pinned, 4, CONFIG.replay)
    for step in range(STEPS):
        ended = jnp.asarray([step < successes, False, False, False])
        obs = jnp.full((4, OBS_SIZE), -1.0) + 0.01 * step
        rows = Transition(
            obs=obs,
            action=jnp.full((4, ACTION_SIZE), -0.5),
            reward=ended.astype(jnp.float32),
            next_obs=obs.at[:, 0].add(0.3),
            terminated=ended,
            truncated=jnp.zeros(4, bool),
        )
        buffer = replay.add(buffer, rows, jnp.ones(4, bool), jnp.int32(step))
    return buffer


def prepared(name="gail"):
    return algorithms.load(name).prepare(jax.random.key(0), PREPARATION, CONFIG)


def adapted(judge, buffer, name):
    """After 500 gradient steps."""
    draw = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (500, *leaf.shape[1:])), EVERY_ROW)
    adapt = jax.jit(algorithms.load(name).adapt, static_argnums=4)
    return adapt(judge, buffer, draw, jax.random.key(1), CONFIG)


def test_a_step_that_ends_is_paid_as_the_same_pay_for_ever_after():
    gamma, logit, ending = 0.9, 0.7, -0.4
    ended, going = gail.imitation_reward(
        jnp.asarray([logit, logit]), jnp.asarray([True, False]), jnp.asarray(ending), gamma
    )
    ever_after = sum(gamma**k * (1 - gamma) * softplus(ending) for k in range(1, 500))
    assert going == pytest.approx((1 - gamma) * softplus(logit), rel=1e-5)
    assert ended == pytest.approx(float(going) + ever_after, rel=1e-5)


@pytest.mark.parametrize("ending", [-2.0, 0.0, 2.0])
def test_ending_is_worth_more_than_going_on_only_if_its_logit_is_larger(ending):
    """Neither a bonus nor a penalty for surviving: the value of going on is that of its pay."""
    gamma, logits = 0.98, np.asarray([-3.0, -1.0, 1.0, 3.0])
    ended = np.asarray(gail.imitation_reward(logits, np.ones(4, bool), jnp.asarray(ending), gamma))
    step = np.asarray(gail.imitation_reward(logits, np.zeros(4, bool), jnp.asarray(ending), gamma))
    for_ever = step / (1 - gamma)
    np.testing.assert_array_equal(ended > for_ever, ending > logits)
    assert (step > 0).all() and (np.diff(step) > 0).all()


def test_the_absorbing_logit_is_the_log_ratio_of_the_shares_of_successes():
    share = jnp.asarray(0.25)
    for successes, demos in ((0, 0), (1, 0), (5, 0), (1, len(PREPARATION.demos.reward))):
        logit = gail.absorbing_logit(share, experience(successes, demos))
        assert logit == pytest.approx(np.log(0.25 / ((successes + 1) / 25)), rel=1e-5)
    assert prepared().success_share == np.mean(PREPARATION.demos.terminated) == 0.5


@pytest.mark.parametrize("name", ["gail", "gaifo", "pofd"])
def test_demonstrated_rows_are_paid_more_than_experience_once_it_was_adapted(name):
    method, buffer = algorithms.load(name), experience(successes=0)
    demos = replay.init(PREPARATION.demos, 4, CONFIG.replay)
    blank = dataclasses.replace(
        demos, storage=demos.storage.replace(reward=0 * demos.storage.reward)
    )
    first = Draw(
        rows=jnp.zeros((1, 1, 3), int), alive=jnp.ones((1, 1, 3), bool), weight=jnp.ones((1, 1))
    )
    judge = prepared(name)
    before = method.relabel(judge, buffer, EVERY_ROW, CONFIG)
    judge = adapted(judge, buffer, name)
    after = method.relabel(judge, buffer, EVERY_ROW, CONFIG)
    expert = method.relabel(judge, blank, first, CONFIG)
    assert after.shape == EVERY_ROW.rows.shape
    assert (after < 0.9 * before).all()
    assert (expert > 1.5 * after.max()).all()


def test_every_batch_drawn_is_one_step_of_the_discriminator():
    buffer, judge = experience(), prepared()
    twice = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * 2), EVERY_ROW)
    after = gail.METHOD.adapt(judge, buffer, twice, jax.random.key(2), CONFIG)
    assert after.discriminator.optimiser[0].count == 2
    np.testing.assert_array_equal(after.discriminator.expert, judge.discriminator.expert)


def with_rows(buffer, **changes):
    return dataclasses.replace(buffer, storage=buffer.storage.replace(**changes))


def test_gail_sees_the_action_and_gaifo_the_next_observation_and_neither_the_reward():
    buffer = experience()
    other = {
        "action": with_rows(buffer, action=buffer.storage.action + 0.3),
        "next_obs": with_rows(buffer, next_obs=buffer.storage.next_obs + 0.3),
        "reward": with_rows(buffer, reward=buffer.storage.reward + 0.3),
    }
    for name, sees in (("gail", "action"), ("gaifo", "next_obs")):
        relabel, judge = algorithms.load(name).relabel, prepared(name)
        usual = relabel(judge, buffer, EVERY_ROW, CONFIG)
        for part, changed in other.items():
            same = np.allclose(relabel(judge, changed, EVERY_ROW, CONFIG), usual, rtol=1e-6)
            assert same == (part != sees)


def test_pofd_adds_its_weight_of_gails_reward_to_that_of_the_task():
    buffer, judge = experience(), prepared()
    imitation = np.asarray(gail.METHOD.relabel(judge, buffer, EVERY_ROW, CONFIG))
    task = np.asarray(buffer.storage.reward)[:24].reshape(1, 8, 3)
    assert task.sum() == 1
    np.testing.assert_allclose(
        pofd.METHOD.relabel(judge, buffer, EVERY_ROW, CONFIG),
        task + pofd.WEIGHT * imitation,
        rtol=1e-6,
    )


def test_gail_learns_the_probe_without_demonstrations_in_its_batches():
    config = probe_env.eager_config("gail")
    learner = train_step.make(probe_env.make(), gail.METHOD, config)
    init = jax.jit(jax.vmap(lambda key: learner.init(key, PREPARATION)))
    states = init(jax.vmap(jax.random.key)(jnp.arange(3)))
    _, metrics = probe_env.assert_learned(learner, states)
    assert (np.asarray(metrics["demo_share"]) == 0).all()
