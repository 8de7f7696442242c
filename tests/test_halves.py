"""Half demonstrations, half experience: how often each row is drawn."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from test_replay import rows

from crsfd_jax.config import Replay
from crsfd_jax.learn import halves, replay

DEMOS, ENVS = 10, 4
CONFIG = Replay(capacity=200, n_step=3)
DRAW = jax.jit(halves.draw, static_argnames=("shape", "replay"))


def filled(steps, broken=()):
    """A ring with `steps` vector steps; the simulation failed in the environments `broken`."""
    state = replay.init(rows(range(DEMOS)), ENVS, CONFIG)
    valid = ~np.isin(np.arange(ENVS), broken)
    for step in range(steps):
        state = replay.add(state, rows(100.0 + np.arange(ENVS)), jnp.asarray(valid), step)
    return state


def with_priorities(state, scale):
    """Unequal priorities; rows without one stay without."""
    factor = scale * jax.random.exponential(jax.random.key(0), state.priority.shape)
    return dataclasses.replace(state, priority=state.priority * (0.1 + factor))


def counts(state, step, shape=(20, 1000)):
    drawn = DRAW(state, step, jax.random.key(7), shape, CONFIG)
    return np.bincount(np.asarray(drawn.rows[..., 0]).ravel(), minlength=DEMOS + CONFIG.capacity)


@pytest.mark.parametrize("size", [7, 64])
def test_every_batch_is_half_demonstrations(size):
    drawn = DRAW(filled(2), 1, jax.random.key(0), (50, size), CONFIG)
    share = np.sum(np.asarray(drawn.rows[..., 0]) < DEMOS, axis=-1)
    np.testing.assert_array_equal(share, size - size // 2)


def test_each_half_is_uniform_whatever_the_priorities():
    often = counts(with_priorities(filled(30), 5.0), 29)
    held = DEMOS + 30 * ENVS
    assert often[held:].sum() == 0
    for half in (often[:DEMOS], often[DEMOS:held]):
        assert half.sum() == 10_000
        assert stats.chisquare(half).pvalue > 1e-3


def test_rows_of_a_failed_simulation_are_never_drawn():
    often = counts(filled(30, broken=(1, 2)), 29)[DEMOS : DEMOS + 30 * ENVS].reshape(30, ENVS)
    assert often[:, [1, 2]].sum() == 0
    assert stats.chisquare(often[:, [0, 3]].ravel()).pvalue > 1e-3


@pytest.mark.parametrize("steps", [0, 5])
def test_demonstrations_fill_the_batch_while_there_is_no_experience(steps):
    often = counts(filled(steps, broken=range(ENVS)), steps)
    assert often[DEMOS:].sum() == 0
    assert stats.chisquare(often[:DEMOS]).pvalue > 1e-3


def test_weights_are_one_and_windows_are_those_of_the_buffer():
    state = filled(5)
    drawn = DRAW(state, 4, jax.random.key(1), (3, 8), CONFIG)
    np.testing.assert_array_equal(drawn.weight, np.ones((3, 8)))
    window, alive = replay.follow(state, 4, drawn.rows[..., 0], CONFIG.n_step)
    np.testing.assert_array_equal(drawn.rows, window)
    np.testing.assert_array_equal(drawn.alive, alive)
