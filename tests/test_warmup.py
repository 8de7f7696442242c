"""Actions before the first update, against numpy and by their distribution."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import probe_env
import pytest

from crsfd_jax import algorithms, task
from crsfd_jax.algorithms.method import Preparation
from crsfd_jax.config import Config, Potential, Replay
from crsfd_jax.demos import builtin
from crsfd_jax.learn import replay
from crsfd_jax.learn.networks import LOG_STD_RANGE
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE, TIP_POSE
from crsfd_jax.training import train_step, warmup

ENVS = 64


@pytest.fixture(scope="module")
def demos():
    rng = np.random.default_rng(0)
    demos = probe_env.preparation(9).demos
    obs = jnp.asarray(rng.normal(size=(9, OBS_SIZE)), jnp.float32)
    return demos.replace(obs=obs, action=jnp.asarray(rng.uniform(-0.9, 0.9, (9, 6)), jnp.float32))


@pytest.fixture(scope="module")
def obs():
    return jax.random.normal(jax.random.key(1), (ENVS, OBS_SIZE))


def actions(demos, obs, how, draws=True, keys=200):
    """[keys, ENVS, A] under as many keys."""
    buffer = replay.init(demos, ENVS, Replay(capacity=ENVS), draws)
    draw = jax.random.split(jax.random.key(2), keys)
    return np.asarray(jax.vmap(lambda key: warmup.action(buffer, obs, key, how))(draw))


def nearest(demos, obs):
    """[ENVS, A] demonstrated actions, by numpy."""
    poses, own = np.asarray(demos.obs)[:, TIP_POSE], np.asarray(obs)[:, TIP_POSE]
    gap = np.linalg.norm(own[:, None] - poses, axis=-1)
    return np.asarray(demos.action)[gap.argmin(axis=1)]


def test_the_action_of_the_nearest_demonstrated_pose_is_taken_with_noise(demos, obs):
    taken, shown = actions(demos, obs, "demos"), nearest(demos, obs)
    assert len(np.unique(shown[:, 0])) > 4
    inside = np.abs(shown) < 0.3  # Where the limits cut nothing off.
    noise = (taken - shown)[:, inside]
    assert abs(noise.mean()) < 0.005 and abs(noise.std() / warmup.NOISE - 1) < 0.02
    assert np.abs(taken).max() == 1.0
    assert np.std(noise.mean(axis=0)) < 3 * warmup.NOISE / np.sqrt(len(taken))


def test_what_is_not_the_pose_does_not_matter(demos, obs):
    pose = np.zeros(OBS_SIZE, bool)
    pose[TIP_POSE] = True
    moved = jnp.where(pose, obs, obs + 5.0)
    np.testing.assert_array_equal(
        actions(demos, obs, "demos", keys=2), actions(demos, moved, "demos", keys=2)
    )


def test_random_actions_are_uniform_between_the_limits(demos, obs):
    taken = actions(demos, obs, "random")
    share, _ = np.histogram(taken, bins=10, range=(-1, 1), density=True)
    np.testing.assert_allclose(share, 0.5, atol=0.01)
    assert np.abs(taken).max() <= 1.0


@pytest.mark.parametrize(("draws", "like"), [(True, "random"), (False, "demos")])
def test_demonstrations_that_are_not_drawn_are_acted_by(demos, obs, draws, like):
    np.testing.assert_array_equal(
        actions(demos, obs, "auto", draws), actions(demos, obs, like, draws)
    )


def test_without_demonstrations_actions_are_random(demos, obs):
    none = jax.tree.map(lambda x: x[:0], demos)
    np.testing.assert_array_equal(actions(none, obs, "auto"), actions(demos, obs, "random"))


@pytest.mark.parametrize(("how", "least", "most"), [("demos", 0.15, 0.5), ("random", 0.0, 0.01)])
def test_a_hole_up_to_4_mm_off_is_found_by_the_demonstrations_and_not_at_random(how, least, most):
    """Over six times the steps of a warm-up; 0.27 is usual."""
    env = task.make_env(Config(shape="2", shift=8e-3))
    given = Preparation.of(builtin.load("builtin"), probe_env.free_space)
    buffer = replay.init(given.demos, ENVS, Replay(capacity=ENVS))

    @jax.jit
    def play(key):
        def step(state, key):
            act_key, env_key = jax.random.split(key)
            taken = warmup.action(buffer, state.obs, act_key, how)
            state, outcome = env.step(state, taken, env_key)
            return state, (outcome.terminated, outcome.truncated)

        reset_key, *keys = jax.random.split(key, 201)
        return jax.lax.scan(step, env.reset(reset_key, ENVS), jnp.stack(keys))[1]

    inserted, ended = (np.asarray(x).sum() for x in play(jax.random.key(0)))
    assert least <= inserted / (inserted + ended) <= most


def stored(algorithm, drawn="auto", start=lambda state: state, **options):
    """[E, A] actions of the first vector step of a run, from a state that `start` makes."""
    config = probe_env.config(algorithm=algorithm, potential=Potential(steps=1))
    replay = dataclasses.replace(config.replay, draw_demos=drawn)
    sac = dataclasses.replace(config.sac, **options)
    config = dataclasses.replace(config, sac=sac, replay=replay)
    learner = train_step.make(probe_env.make(), algorithms.load(algorithm), config)
    preparation = probe_env.preparation(6)

    @jax.jit
    def first_actions(key):
        after, _ = learner.step(start(learner.init(key, preparation)), jnp.int32(0))
        first = after.replay.num_demos
        return after.replay.storage.action[first : first + config.envs]

    return np.asarray(first_actions(jax.random.key(0)))


def test_a_run_begins_as_it_is_told():
    by_rows, alone = stored("crsfd"), stored("crsfd", drawn="no")
    assert (by_rows != alone).any()
    np.testing.assert_array_equal(by_rows, stored("crsfd", warmup="random"))
    np.testing.assert_array_equal(alone, stored("crsfd", warmup="demos"))
    np.testing.assert_array_equal(by_rows, stored("crsfd", drawn="no", warmup="random"))
    np.testing.assert_array_equal(alone, stored("sacfd", drawn="no"))
    np.testing.assert_array_equal(alone, stored("sacfd", warmup="demos"))
    np.testing.assert_array_equal(by_rows, stored("sacfd"))
    np.testing.assert_array_equal(by_rows, stored("sac"))
    for imitator in ("gail", "gaifo", "pofd"):
        np.testing.assert_array_equal(alone, stored(imitator))


def constant(actor, mean):
    """Parameters of the same shapes: normal before the tanh, in the middle of the deviations."""
    *_, last = sorted(actor["params"])
    zeros = jax.tree.map(jnp.zeros_like, actor)
    bias = zeros["params"][last]["bias"].at[:ACTION_SIZE].set(mean)
    return {"params": zeros["params"] | {last: zeros["params"][last] | {"bias": bias}}}


def test_after_warmup_the_newest_actor_acts_and_is_sampled():
    def start(state):
        newest, average = (constant(state.agent.actor, mean) for mean in (0.5, -0.5))
        return state.replace(agent=state.agent.replace(actor=newest, average_actor=average))

    drawn = np.arctanh(stored("sacfd", start=start, warmup_steps=0))
    deviation = np.exp(np.mean(LOG_STD_RANGE))
    assert abs(drawn.mean() - 0.5) < 4 * deviation / np.sqrt(drawn.size)
    assert abs(drawn.std() / deviation - 1) < 4 / np.sqrt(2 * drawn.size)
    np.testing.assert_array_equal(stored("sacfd", start=start), stored("sacfd"))
