"""The prioritised ring, against slow numpy models of what it should hold and return."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from crsfd_jax.config import Replay
from crsfd_jax.learn import replay
from crsfd_jax.types import Transition

GAMMA = 0.9
CONFIG = Replay(capacity=24, n_step=3)
DRAW = jax.jit(replay.draw, static_argnames=("shape", "replay"))


def rows(tags, terminated=False, truncated=False) -> Transition:
    """Transitions that carry their tag in every field, so that mix-ups show."""
    tags = np.asarray(tags, np.float32)
    return Transition(
        obs=jnp.asarray(np.stack([tags, -tags], axis=-1)),
        action=jnp.asarray(tags[:, None] / 100),
        reward=jnp.asarray(tags),
        next_obs=jnp.asarray(np.stack([tags + 0.5, -tags - 0.5], axis=-1)),
        terminated=jnp.asarray(np.broadcast_to(terminated, tags.shape)),
        truncated=jnp.asarray(np.broadcast_to(truncated, tags.shape)),
    )


def with_priority(priority, config=CONFIG, num_envs=1):
    priority = np.asarray(priority, np.float32)
    config = dataclasses.replace(config, capacity=len(priority))
    state = replay.init(rows([]), num_envs, config)
    leaves = jnp.zeros_like(state.priority).at[: len(priority)].set(priority)
    return dataclasses.replace(state, priority=leaves)


def drawn(state, key, shape, config=CONFIG, step=0):
    return DRAW(state, step, key, shape, config)


def read(state, draw, gamma=GAMMA):
    return replay.gather(state, draw, state.storage.reward[draw.rows], gamma)


def at_rows(state, step, row_numbers, config=CONFIG):
    """A draw of the given rows, as if chance had picked them."""
    window, alive = replay.follow(state, step, jnp.asarray(row_numbers), config.n_step)
    return replay.Draw(rows=window, alive=alive, weight=jnp.ones(len(row_numbers)))


def test_rows_are_drawn_in_proportion_to_their_priority():
    rng = np.random.default_rng(0)
    priority = rng.pareto(1.5, size=700) * (rng.random(700) < 0.8)
    state = with_priority(priority)
    picks = drawn(state, jax.random.key(3), (50, 2000)).rows[..., 0]
    counts = np.bincount(np.asarray(picks).ravel(), minlength=700)
    assert counts[priority == 0].sum() == 0
    live = priority > 0
    expected = priority[live] / priority.sum() * counts.sum()
    often = expected > 10
    observed = np.append(counts[live][often], counts[live][~often].sum())
    expected = np.append(expected[often], expected[~often].sum())
    assert stats.chisquare(observed, expected * observed.sum() / expected.sum()).pvalue > 1e-3


def test_exponent_zero_draws_uniformly_and_weighs_equally():
    config = dataclasses.replace(CONFIG, capacity=200, priority_exponent=0.0)
    state = replay.init(rows(range(50)), 50, config)
    for step in range(3):
        valid = jnp.arange(50) != 7
        state = replay.add(state, rows(range(50)), valid, step)
    errors = jax.random.exponential(jax.random.key(1), (4, 64))
    state = replay.reprioritise(
        state, drawn(state, jax.random.key(0), (4, 64), config, 2), errors, config
    )
    draw = drawn(state, jax.random.key(2), (10, 2000), config, 2)
    counts = np.bincount(np.asarray(draw.rows[..., 0]).ravel(), minlength=250)
    empty = np.r_[50 + 7, 100 + 7, 150 + 7, 200:250]
    assert counts[empty].sum() == 0
    assert stats.chisquare(np.delete(counts, empty)).pvalue > 1e-3
    np.testing.assert_array_equal(draw.weight, 1.0)


def test_importance_weights_equal_those_computed_by_hand():
    config = dataclasses.replace(CONFIG, importance_exponent=0.5)
    state = with_priority([1.0, 4.0, 9.0, 2.0], config)
    draw = drawn(state, jax.random.key(0), (3, 8), config)
    picked = np.asarray(draw.rows[..., 0])
    probability = np.asarray([1.0, 4.0, 9.0, 2.0])[picked] / 16.0
    by_hand = (4 * probability) ** -0.5
    by_hand /= by_hand.max(axis=-1, keepdims=True)
    np.testing.assert_allclose(draw.weight, by_hand, rtol=1e-6)
    assert set(picked.ravel()) == {0, 1, 2, 3}


def test_no_empty_row_is_drawn_out_of_three_hundred_thousand():
    rng = np.random.default_rng(0)
    size = 300_000
    priority = np.abs(rng.standard_cauchy(size)) ** 0.6 * (rng.random(size) < 0.3)
    priority[:50_000] = 0.0
    state = with_priority(priority)
    pick = jax.jit(lambda key: replay.draw_rows(state.priority, key, (500_000,)))
    picks = np.concatenate([np.asarray(pick(jax.random.key(i))) for i in range(2)])
    assert picks.max() < size
    assert (priority[picks] > 0).all()
    halves = [picks < 175_000, priority[:175_000].sum() / priority.sum()]
    assert halves[0].mean() == pytest.approx(halves[1], abs=3e-3)


@pytest.mark.parametrize("uniform", [0.0, 0.5, 1.0 - 2**-24, 1.0])
def test_the_extremes_of_the_random_number_never_pick_an_empty_entry(uniform):
    mass = jnp.asarray([0.0, 0.0, 3.0, 0.0, 1e-9, 5.0, 0.0])
    assert mass[replay._pick(mass, jnp.asarray(uniform))] > 0


def test_rounding_in_the_cumulative_sum_never_picks_an_empty_entry():
    """Aims at every step of the sum, where an empty entry can seem one rounding error wide."""
    rng = np.random.default_rng(0)
    mass = (rng.pareto(1.0, size=2400) * (rng.random(2400) < 0.3)).astype(np.float32)
    steps = np.cumsum(mass, dtype=np.float64)
    aims = np.asarray(steps / steps[-1], np.float32)[:, None] + np.arange(-4, 5) * 2.0**-25
    picks = jax.jit(replay._pick)(mass, jnp.asarray(np.clip(aims, 0.0, 1.0), jnp.float32))
    assert (mass[picks] > 0).all()


def test_demonstrations_survive_several_wraps_and_the_newest_rows_replace_the_oldest():
    state = replay.init(rows(range(5)), 4, CONFIG)
    add = jax.jit(replay.add)
    for step in range(20):
        state = add(state, rows(100 + 4 * step + np.arange(4)), jnp.ones(4, bool), step)
    tags = np.asarray(state.storage.reward)
    np.testing.assert_array_equal(tags[:5], np.arange(5))
    np.testing.assert_array_equal(np.sort(tags[5:]), 100 + np.arange(80 - 24, 80))
    np.testing.assert_array_equal(tags[5 + 4 : 5 + 8], 100 + 4 * 19 + np.arange(4))
    np.testing.assert_array_equal(state.storage.obs[:, 0], tags)


def test_new_rows_enter_with_the_largest_priority_and_invalid_ones_are_blank():
    state = replay.init(rows([1.0, 2.0]), 3, CONFIG)
    state = dataclasses.replace(state, max_priority=jnp.asarray(7.0))
    broken = rows([3.0, np.nan, 5.0])
    state = replay.add(state, broken, jnp.asarray([True, False, True]), 0)
    np.testing.assert_array_equal(state.priority[2:6], [7.0, 0.0, 7.0, 0.0])
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))
    assert np.all(state.storage.obs[3] == 0)


def test_priorities_follow_the_error_the_floor_and_the_demo_bonus():
    config = Replay(
        capacity=4, priority_exponent=0.5, priority_floor=0.01, demo_bonus=0.2, n_step=1
    )
    state = replay.init(rows([0.0, 1.0]), 2, config)
    state = replay.add(state, rows([2.0, 3.0]), jnp.ones(2, bool), 0)
    before = np.asarray(state.priority)
    draw = at_rows(state, 0, [0, 2, 2, 3], config)
    errors = jnp.asarray([-0.5, 0.1, -3.0, 0.0])
    state = replay.reprioritise(state, draw, errors, config)
    expected = [np.sqrt(0.71), before[1], np.sqrt(3.01), np.sqrt(0.01)]
    np.testing.assert_allclose(state.priority[:4], expected, rtol=1e-6)
    assert state.max_priority == pytest.approx(np.sqrt(3.01))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("exponent", [0.0, 0.6])
def test_an_error_that_is_not_finite_leaves_its_row_as_it_was(bad, exponent):
    config = dataclasses.replace(CONFIG, priority_exponent=exponent)
    state = replay.init(rows([0.0, 1.0, 2.0]), 2, config)
    state = dataclasses.replace(state, priority=state.priority.at[1].set(0.3))
    new = replay.reprioritise(state, at_rows(state, 0, [1, 2]), jnp.asarray([bad, 0.5]), config)
    assert new.priority[1] == pytest.approx(0.3)
    assert np.isfinite(new.priority).all() and np.isfinite(new.max_priority)


class Model:
    """What the buffer means: for every row, the rows that follow it in its episode."""

    def __init__(self, demos, num_envs, capacity):
        self.streams = [[] for _ in range(num_envs)]
        self.demos = demos
        self.capacity = capacity

    def add(self, transition, valid):
        for env, stream in enumerate(self.streams):
            row = jax.tree.map(lambda x, env=env: np.asarray(x)[env], transition)
            stream.append((row, bool(valid[env])))

    def backup(self, sequence, start, length):
        """Slow n-step return from position `start` of a list of (row, valid)."""
        reward, steps = 0.0, 0
        for row, valid in sequence[start : start + length]:
            if not valid:
                break
            reward += GAMMA**steps * float(row.reward)
            steps += 1
            last = row
            if row.terminated or row.truncated:
                break
        return reward, steps, last.next_obs, bool(last.terminated)

    def sequences(self):
        """(buffer row, sequence, position) of every drawable row."""
        size = len(self.demos.reward)
        demo = [
            (jax.tree.map(lambda x, i=i: np.asarray(x)[i], self.demos), True) for i in range(size)
        ]
        yield from ((i, demo, i) for i in range(size))
        num_envs = len(self.streams)
        ring = self.capacity // num_envs
        for env, stream in enumerate(self.streams):
            for time in range(max(0, len(stream) - ring), len(stream)):
                if stream[time][1]:
                    yield size + (time % ring) * num_envs + env, stream, time


def random_history(seed, n_step, steps):
    rng = np.random.default_rng(seed)
    ends = rng.random(9) < 0.3
    demos = rows(np.arange(9.0), terminated=ends, truncated=~ends & (rng.random(9) < 0.2))
    config = dataclasses.replace(CONFIG, n_step=n_step)
    state, model = replay.init(demos, 4, config), Model(demos, 4, 24)
    add = jax.jit(replay.add)
    for step in range(steps):
        terminated = rng.random(4) < 0.15
        truncated = ~terminated & (rng.random(4) < 0.15)
        valid = rng.random(4) < 0.85
        new = rows(100.0 + 4 * step + np.arange(4), terminated, truncated)
        state = add(state, new, jnp.asarray(valid), step)
        model.add(new, valid)
    return state, model, config


@pytest.mark.parametrize("n_step", [1, 3, 7])
@pytest.mark.parametrize("steps", [1, 5, 6, 9, 21])
def test_n_step_returns_agree_with_a_slow_model_on_random_histories(n_step, steps):
    state, model, config = random_history(10 * steps + n_step, n_step, steps)
    entries = list(model.sequences())
    draw = at_rows(state, steps - 1, [row for row, _, _ in entries], config)
    batch = read(state, draw)
    assert set(np.flatnonzero(state.priority)) == {row for row, _, _ in entries}
    for backup, length in ((batch.one_step, 1), (batch.n_step, n_step)):
        for i, (_, sequence, start) in enumerate(entries):
            reward, count, next_obs, terminated = model.backup(sequence, start, length)
            assert backup.length[i] == count
            assert backup.reward[i] == pytest.approx(reward, rel=1e-5)
            assert backup.terminated[i] == terminated
            np.testing.assert_array_equal(backup.next_obs[i], next_obs)


def test_only_rows_that_the_model_knows_are_ever_drawn():
    state, model, config = random_history(5, 3, 13)
    draw = drawn(state, jax.random.key(0), (16, 256), config, 12)
    known = {row for row, _, _ in model.sequences()}
    assert set(np.asarray(draw.rows[..., 0]).ravel()) == known
    assert draw.alive[..., 0].all()


def test_adding_to_a_large_vmapped_buffer_does_not_copy_it():
    config = Replay(capacity=100_000)
    fresh = jax.vmap(lambda _: replay.init(rows([0.0]), 4, config))(jnp.arange(3))

    def fill(state):
        def body(carry, _):
            state, step = carry
            add = jax.vmap(replay.add, in_axes=(0, None, None, None))
            return (add(state, rows(np.arange(4.0)), jnp.ones(4, bool), step), step + 1), None

        return jax.lax.scan(body, (state, 0), length=10)[0]

    compiled = jax.jit(fill, donate_argnums=0).lower(fresh).compile()
    memory = compiled.memory_analysis()
    assert memory.temp_size_in_bytes < 0.1 * memory.argument_size_in_bytes
