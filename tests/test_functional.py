"""The functional form says what the environment says, one environment or many."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from crsfd_jax import functional, task
from crsfd_jax.config import Config, Mdp

COUNT, STEPS = 6, 7
OPTIONS = Config(shape="2", shift=8e-3, engine="native", mdp=Mdp(horizon=5))


@pytest.fixture(scope="module")
def single():
    return functional.make(OPTIONS)


@pytest.fixture(scope="module")
def env():
    return task.make_env(OPTIONS)


@pytest.fixture(scope="module")
def start(single):
    return jax.jit(single.reset)(jax.random.key(0))


def actions(count=COUNT):
    return jax.random.uniform(jax.random.key(1), (STEPS, count, 6), minval=-1, maxval=1)


def close(one, other):
    """Equal but for the rounding of differently fused programs."""
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-3)


def test_the_sizes_are_those_of_the_task(single):
    state = jax.eval_shape(single.reset, jax.random.key(0))
    assert state.obs.shape == (single.observation_size,) == (29,)
    assert state.reward.shape == state.done.shape == ()
    assert single.action_size == 6 and single.mj_model.nq == 7
    assert single.dt == pytest.approx(single.sim_dt * single.n_substeps) == pytest.approx(0.1)


def test_an_episode_is_that_of_the_environment_step_for_step(single, env):
    """The environment replaces what ended, so only the outcome is compared at the last step."""
    key = jax.random.key(3)
    state, ours = jax.jit(single.reset)(key), jax.jit(env.reset, static_argnums=1)(key, 1)
    close(state.data, jax.tree.map(lambda x: x[0], ours))
    reference, step = jax.jit(env.step), jax.jit(single.step)
    for i, action in enumerate(actions(1)[: OPTIONS.mdp.horizon]):
        assert not state.done
        state = step(state, action[0])
        ours, outcome = reference(ours, action, key)
        close(state.obs, outcome.next_obs[0])
        assert state.reward == outcome.reward[0] == state.metrics["success"] == 0
        assert state.info["truncation"] == outcome.truncated[0] == state.done
        assert bool(state.done) == (i == OPTIONS.mdp.horizon - 1)


def test_many_environments_by_vmap_and_scan_are_a_batch(single, env):
    """With the native engine, whose calls must take the new axis."""

    def play(state, action):
        return jax.lax.scan(lambda s, a: (single.step(s, a), s.obs), state, action)

    states = jax.jit(jax.vmap(single.reset))(jax.random.split(jax.random.key(0), COUNT))
    batched = jax.jit(jax.vmap(play, in_axes=(0, 1)))
    after, seen = batched(states, actions())
    ours, advance = states.data, jax.jit(env.advance)
    for t, action in enumerate(actions()):
        close(seen[:, t], ours.obs)
        ours, _ = advance(ours, action)
    close(after.data.tip, ours.tip)
    close(after.data.around, ours.around)


def test_episodes_of_different_keys_differ_and_of_equal_keys_do_not(single):
    reset = jax.jit(single.reset)
    first, same, other = (reset(jax.random.key(k)) for k in (0, 0, 1))
    np.testing.assert_array_equal(first.obs, same.obs)
    offsets = [np.asarray(s.data.around.socket_offset) for s in (first, other)]
    assert (offsets[0] != offsets[1]).all() and np.abs(offsets).max() <= 4e-3


def test_insertion_ends_an_episode_with_reward_and_without_truncation(single, start, nearly_in):
    state = jax.jit(single.step)(nearly_in(start), down())
    assert state.done == state.reward == state.metrics["success"] == 1
    assert state.info["truncation"] == state.metrics["nonfinite"] == 0


def test_a_broken_simulation_ends_the_episode_as_truncated_with_its_last_observation(single, start):
    broken = start.data.physics.replace(qvel=start.data.physics.qvel.at[2].set(jnp.nan))
    after = jax.jit(single.step)(start.replace(data=start.data.replace(physics=broken)), down())
    assert after.done == after.info["truncation"] == after.metrics["nonfinite"] == 1
    assert after.reward == after.metrics["success"] == 0
    np.testing.assert_array_equal(after.obs, start.obs)


def test_what_a_wrapper_keeps_in_info_stays_there(single, start):
    state = start.replace(info={**start.info, "steps": jnp.float32(3)})
    assert jax.jit(single.step)(state, down()).info["steps"] == 3


def down():
    return jnp.zeros(6).at[2].set(-1.0)


@pytest.fixture(scope="module")
def nearly_in(at_rest):
    """(state) -> the same with the peg in its socket, 4 mm above the floor."""

    def place(state):
        offset = np.asarray(state.data.around.socket_offset)
        position = np.array([*offset, -0.026])
        physics = jax.tree.map(lambda x: x[0], at_rest(position[None]))
        tip = jnp.asarray([*position, 0, 0, 0], jnp.float32)
        return state.replace(data=state.data.replace(physics=physics, tip=tip))

    return place
