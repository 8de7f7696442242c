"""Returns, the conservative value function and reward shaping, on cases with known values."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import random_batch

from crsfd_jax import algorithms, config
from crsfd_jax.algorithms import crsfd
from crsfd_jax.algorithms.method import Preparation
from crsfd_jax.learn import potential
from crsfd_jax.learn.replay import Backup
from crsfd_jax.learn.returns import monte_carlo_returns
from crsfd_jax.learn.shaping import shape_reward
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE, POSE_SCALE, TIP_POSE
from crsfd_jax.types import Transition

LENGTH = 10
QUICK = config.Potential(gamma=0.8, steps=800, batch_size=128, hidden=(32, 32), terminal="zero")


def chain_demos(episodes=4, successes=4) -> Transition:
    """Walks along x = 0.0, 0.1, ... at y = 0; the first `successes` reach the goal x = 1."""
    positions = np.tile(np.arange(LENGTH) / LENGTH, episodes)
    last = np.tile(np.arange(LENGTH) == LENGTH - 1, episodes)
    successful = np.repeat(np.arange(episodes) < successes, LENGTH)
    obs = np.stack([positions, 0 * positions], axis=-1)
    return Transition(
        obs=jnp.asarray(obs),
        action=jnp.zeros((len(obs), 1)),
        reward=jnp.asarray(last & successful, jnp.float32),
        next_obs=jnp.asarray(obs + np.asarray([1 / LENGTH, 0.0])),
        terminated=jnp.asarray(last & successful),
        truncated=jnp.asarray(last & ~successful),
    )


def free_space(key, n):
    """Uniform in a square that surrounds the chain; a point lies off it almost surely."""
    return jax.random.uniform(key, (n, 2), minval=-3.0, maxval=3.0)


def test_returns_of_a_chain_are_powers_of_gamma():
    returns = monte_carlo_returns(chain_demos(), 0.8)
    expected = 0.8 ** np.arange(LENGTH - 1, -1, -1)
    np.testing.assert_allclose(returns.reshape(4, LENGTH), np.tile(expected, (4, 1)), rtol=1e-6)


def test_returns_of_any_rewards_equal_the_sum_of_their_definition():
    rng = np.random.default_rng(0)
    ends = np.array([3, 4, 11, 19])
    demos = dataclasses.replace(
        chain_demos(episodes=2),
        reward=rng.normal(size=20),
        terminated=np.isin(np.arange(20), ends[::2]),
        truncated=np.isin(np.arange(20), ends[1::2]),
    )
    for row, actual in enumerate(monte_carlo_returns(demos, 0.9)):
        end = ends[ends >= row][0]
        expected = sum(0.9 ** (i - row) * demos.reward[i] for i in range(row, end + 1))
        assert actual == pytest.approx(expected, rel=1e-5)


def test_an_episode_that_runs_out_of_time_returns_nothing():
    returns = monte_carlo_returns(chain_demos(episodes=2, successes=1), 0.8)
    assert (returns[:LENGTH] > 0).all()
    np.testing.assert_array_equal(returns[LENGTH:], 0.0)


def test_success_states_are_targets_of_one_only_if_the_terminal_potential_is_kept():
    demos = chain_demos(episodes=3, successes=2)
    obs, targets = potential.demonstration_targets(demos, QUICK)
    keep = dataclasses.replace(QUICK, terminal="keep")
    kept_obs, kept_targets = potential.demonstration_targets(demos, keep)
    np.testing.assert_array_equal(kept_obs[:20], obs)
    np.testing.assert_array_equal(kept_targets[:20], targets)
    np.testing.assert_allclose(kept_obs[20:], [[1.0, 0.0]] * 2)
    np.testing.assert_array_equal(kept_targets[20:], 1.0)


def test_episodes_that_fail_are_no_targets():
    demos = chain_demos(episodes=3, successes=2)
    obs, targets = potential.demonstration_targets(demos, QUICK)
    np.testing.assert_array_equal(obs, demos.obs[: 2 * LENGTH])
    np.testing.assert_array_equal(targets, monte_carlo_returns(demos, QUICK.gamma)[: 2 * LENGTH])
    whole = chain_demos(episodes=3, successes=3)
    np.testing.assert_array_equal(potential.demonstration_targets(whole, QUICK)[0], whole.obs)


def stay(key, features):
    """Demonstrations are as good where they are only."""
    return features


def test_potential_is_the_return_on_demonstrations_and_zero_in_free_space():
    features, targets = potential.demonstration_targets(chain_demos(), QUICK)
    fitted = potential.fit(jax.random.key(0), features, targets, free_space, QUICK, stay)
    on_demos = potential.evaluate(fitted, features)
    rmse = np.sqrt(np.mean((np.asarray(on_demos) - targets) ** 2))
    assert rmse < 0.08
    probes = potential.evaluate(fitted, free_space(jax.random.key(5), 4000))
    assert probes.mean() < 0.05
    assert (np.diff(on_demos[:LENGTH]) > 0).all()
    assert probes.min() >= 0.0 and max(probes.max(), on_demos.max()) <= 1.0


def test_free_space_weight_is_what_keeps_the_potential_down_off_the_demonstrations():
    features, targets = potential.demonstration_targets(chain_demos(), QUICK)
    careless = dataclasses.replace(QUICK, free_space_weight=0.0)
    probes = free_space(jax.random.key(5), 4000)

    def mean_in_free_space(options):
        fitted = potential.fit(jax.random.key(0), features, targets, free_space, options, stay)
        return potential.evaluate(fitted, probes).mean()

    assert mean_in_free_space(careless) > 5 * mean_in_free_space(QUICK)


def test_regression_loss_equals_the_one_computed_in_numpy():
    fitted = potential.fit(
        jax.random.key(0),
        jnp.zeros((1, 2)),
        jnp.zeros(1),
        free_space,
        dataclasses.replace(QUICK, steps=1),
        stay,
    )
    features, far = np.random.default_rng(0).normal(size=(2, 5, 2))
    targets = np.linspace(0, 1, 5)
    on_demos = np.asarray(potential.evaluate(fitted, features))
    on_free = np.asarray(potential.evaluate(fitted, far))
    expected = np.mean((on_demos - targets) ** 2) + 0.3 * np.mean(on_free**2)
    actual = potential.regression_loss(fitted, features, targets, far, 0.3)
    assert actual == pytest.approx(expected, rel=1e-5)


def random_path(seed, length, terminated):
    rng = np.random.default_rng(seed)
    rewards, potentials = rng.normal(size=length), rng.random(length + 1)
    ends = np.zeros(length, bool)
    ends[-1] = terminated
    return rewards, potentials, ends


def backup(reward, terminated, length):
    return Backup(
        reward=jnp.asarray(reward),
        next_obs=jnp.zeros((*np.shape(reward), 1)),
        terminated=jnp.asarray(terminated),
        length=jnp.asarray(length),
    )


@pytest.mark.parametrize("terminal", ["zero", "keep"])
@pytest.mark.parametrize("terminated", [False, True])
@pytest.mark.parametrize("length", [1, 3, 8])
def test_shaped_n_step_reward_is_the_sum_of_the_shaped_rewards(terminal, terminated, length):
    gamma = 0.97
    rewards, potentials, ends = random_path(length, length, terminated)
    one_step = shape_reward(
        backup(rewards, ends, np.ones(length, int)),
        potentials[:-1],
        potentials[1:],
        gamma,
        terminal,
    )
    discounts = gamma ** np.arange(length)
    n_step = shape_reward(
        backup(np.sum(discounts * rewards), terminated, length),
        potentials[0],
        potentials[-1],
        gamma,
        terminal,
    )
    assert n_step.reward == pytest.approx(float(np.sum(discounts * one_step.reward)), abs=1e-5)
    kept = 0.0 if terminated and terminal == "zero" else potentials[-1]
    telescoped = np.sum(discounts * rewards) + gamma**length * kept - potentials[0]
    assert n_step.reward == pytest.approx(telescoped, abs=1e-5)


def test_a_truncated_step_keeps_its_potential_and_a_terminal_one_loses_it_only_if_told():
    plain = backup([0.0, 1.0], [False, True], [1, 1])
    phi, next_phi = jnp.asarray([0.2, 0.7]), jnp.asarray([0.5, 0.9])
    zero = shape_reward(plain, phi, next_phi, 0.9, "zero").reward
    keep = shape_reward(plain, phi, next_phi, 0.9, "keep").reward
    np.testing.assert_allclose(zero, [0.9 * 0.5 - 0.2, 1.0 - 0.7], rtol=1e-6)
    np.testing.assert_allclose(keep, [0.9 * 0.5 - 0.2, 1.0 + 0.9 * 0.9 - 0.7], rtol=1e-6)


def test_shaping_is_nothing_on_a_demonstration_whose_gamma_is_the_same():
    returns = monte_carlo_returns(chain_demos(episodes=1), 0.8)
    steps = LENGTH - 1
    before_goal = backup(np.zeros(steps), np.zeros(steps, bool), np.ones(steps, int))
    same = shape_reward(before_goal, returns[:-1], returns[1:], 0.8, "keep").reward
    larger = shape_reward(before_goal, returns[:-1], returns[1:], 0.9, "keep").reward
    np.testing.assert_allclose(same, 0.0, atol=1e-6)
    np.testing.assert_allclose(larger, (0.9 / 0.8 - 1) * returns[:-1], rtol=1e-5)


def test_moved_demonstrations_are_valued_by_the_mean_of_all_places_they_may_come_from():
    """Half of the chain's copies lie at y = 0, half at y = 1, where nothing else is known."""
    features, targets = potential.demonstration_targets(chain_demos(), QUICK)
    careless = dataclasses.replace(QUICK, free_space_weight=0.0, steps=3000)

    def move(key, features):
        side = jax.random.bernoulli(key, 0.5, (len(features),))
        return jnp.asarray(features).at[:, 1].add(side)

    def value_at(y, move):
        key = jax.random.key(0)
        fitted = potential.fit(key, features, targets, free_space, careless, move)
        return np.asarray(potential.evaluate(fitted, features + jnp.array([0.0, y])))[:LENGTH]

    np.testing.assert_allclose(value_at(0.0, move), targets[:LENGTH], atol=0.06)
    np.testing.assert_allclose(value_at(1.0, move), targets[:LENGTH], atol=0.06)

    def reverse(key, features):
        """Every state as likely the one at the other end of the chain."""
        swap = jax.random.bernoulli(key, 0.5, (len(features), 1))
        mirrored = jnp.array([1.0 - 1 / LENGTH, 0.0]) - features
        return jnp.where(swap, mirrored, features)

    mean = (targets[:LENGTH] + targets[:LENGTH][::-1]) / 2
    np.testing.assert_allclose(value_at(0.0, reverse), mean, atol=0.06)


def test_demonstrated_poses_move_in_x_and_y_within_the_square_and_no_further():
    poses = jnp.asarray(np.random.default_rng(0).normal(size=(4000, 6)), jnp.float32)
    change = np.asarray(crsfd.moved(jax.random.key(0), poses, 0.008) - poses) * POSE_SCALE
    assert np.abs(change[:, :2]).max() <= 0.004 + 1e-6
    np.testing.assert_allclose(change[:, :2].mean(axis=0), 0.0, atol=2e-4)
    np.testing.assert_allclose(change[:, :2].std(axis=0), 0.008 / np.sqrt(12), rtol=0.03)
    assert abs(np.corrcoef(change[:, :2].T)[0, 1]) < 0.06
    np.testing.assert_array_equal(change[:, 2:], 0.0)


def test_the_potential_of_a_hole_that_may_have_moved_is_flat_where_it_may_be():
    """Top at the nominal place without a spread; with one, nearly as high in its corners."""
    rng = np.random.default_rng(1)
    depth = np.tile(np.linspace(0.05, -0.028, 16), 40)
    tip = np.zeros((len(depth), 6), np.float32)
    tip[:, :2], tip[:, 2] = rng.normal(0, 3e-4, (len(depth), 2)), depth
    obs = np.zeros((len(depth), OBS_SIZE), np.float32)
    obs[:, TIP_POSE] = tip / POSE_SCALE
    last = np.arange(len(depth)) % 16 == 15
    demos = Transition(
        obs=obs,
        action=np.zeros((len(depth), 1)),
        reward=last.astype(np.float32),
        next_obs=obs,
        terminated=last,
        truncated=np.zeros(len(depth), bool),
    )

    def around(key, count):
        return jax.random.uniform(key, (count, 6), minval=-5, maxval=5)

    def drop(shift, spread, demo_shift=0.0):
        """How far the potential falls from the nominal mouth to 4 mm aside."""
        options = config.Potential(steps=1500, spread=spread)
        run = config.Config(shift=shift, potential=options)
        fitted = crsfd.prepare(jax.random.key(0), Preparation(demos, around, demo_shift), run)
        mouth = np.zeros((3, 6), np.float32)
        mouth[1, 0], mouth[2, :2] = 0.004, -0.003
        middle, *aside = np.asarray(potential.evaluate(fitted, mouth / POSE_SCALE))
        return middle - np.mean(aside)

    assert drop(0.0, None) > 3 * abs(drop(0.008, None))
    assert drop(0.008, 0.0) == drop(0.0, None)
    assert drop(0.0, 0.008) == drop(0.008, None)
    assert drop(0.008, None, demo_shift=0.008) == drop(0.004, None, demo_shift=0.006)
    assert drop(0.008, None, demo_shift=0.008) == drop(0.0, None)


@pytest.mark.parametrize(
    ("shift", "demo_shift", "draws"),
    [(0.0, 0.0, True), (0.004, 0.0, False), (0.008, 0.004, False), (0.008, 0.008, True)],
)
def test_demonstrations_of_a_socket_in_a_smaller_square_are_in_no_batch_of_a_shaped_method(
    shift, demo_shift, draws
):
    options = config.Config(shift=shift)
    given = Preparation(None, None, demo_shift)
    for name in ("crsfd", "crsfd_no_free_space", "crsfd_same_gamma", "rsgm"):
        assert algorithms.load(name).draws_demos(given, options) == draws
    assert algorithms.load("sacfd").draws_demos(given, options)


@pytest.mark.parametrize("terminal", ["keep", "zero"])
def test_crsfd_shapes_both_backups(monkeypatch, terminal):
    """With a known potential of the tip's pose, by hand, row by row."""
    batch = random_batch.batch(OBS_SIZE, ACTION_SIZE)
    monkeypatch.setattr(crsfd.potential, "evaluate", lambda fitted, pose: pose[..., 2] ** 2)
    options = config.Config(potential=config.Potential(terminal=terminal))
    shaped = crsfd.METHOD.reward((), batch, options)
    phi = np.asarray(batch.obs)[:, TIP_POSE][:, 2] ** 2
    for before, after in ((batch.one_step, shaped.one_step), (batch.n_step, shaped.n_step)):
        for i in range(random_batch.BATCH):
            next_phi = float(before.next_obs[i, TIP_POSE][2]) ** 2
            if terminal == "zero" and before.terminated[i]:
                next_phi = 0.0
            gained = 0.98 ** int(before.length[i]) * next_phi - phi[i]
            assert after.reward[i] == pytest.approx(float(before.reward[i]) + gained, abs=1e-5)
        kept = after.replace(reward=before.reward)
        jax.tree.map(np.testing.assert_array_equal, kept, before)
