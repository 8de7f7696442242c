"""The insertion task: what is observed, what is rewarded, what ends and what is drawn anew."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from crsfd_jax import config, env, observation, task
from crsfd_jax.demos.expert import dense_reward
from crsfd_jax.scene import digits

COUNT = 16
OPTIONS = config.Config(shape="2", shift=8e-3, engine="native")
DOWN = jnp.zeros((COUNT, 6)).at[:, 2].set(-1.0)
STILL = jnp.zeros((COUNT, 6))
KEY = jax.random.key(7)


@pytest.fixture(scope="module")
def make():
    """(options, reward) -> the environment with a compiled step."""

    def compiled(options, reward=env.sparse_reward):
        made = task.make_env(options, reward)
        return made._replace(step=jax.jit(made.step), reset=jax.jit(made.reset, static_argnums=1))

    return compiled


@pytest.fixture(scope="module")
def world(make):
    return make(OPTIONS)


@pytest.fixture(scope="module")
def fresh(world):
    return world.reset(jax.random.key(0), COUNT)


@pytest.fixture(scope="module")
def nearly_in(fresh, at_rest):
    """Every peg in its own socket, 4 mm above the floor."""
    offset = np.asarray(fresh.around.socket_offset)
    height = np.full(COUNT, -digits.HOLE_DEPTH + 4e-3)
    physics = at_rest(np.column_stack([offset, height]))
    tip = jnp.asarray(np.column_stack([offset, height, np.zeros((COUNT, 3))]), jnp.float32)
    return fresh.replace(physics=physics, tip=tip)


def equal(one, other):
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


def rows(tree, index):
    return jax.tree.map(lambda leaf: np.asarray(leaf)[index], tree)


# Observation


def measured(scene, physics, i):
    """Position, rotation vector, velocity and angular velocity of the tip by MuJoCo, float64."""
    data = mujoco.MjData(scene.model)
    data.qpos[:], data.qvel[:] = physics.qpos[i], physics.qvel[i]
    mujoco.mj_forward(scene.model, data)
    quaternion, vector, twist = np.zeros(4), np.zeros(3), np.zeros(6)
    site = mujoco.mjtObj.mjOBJ_SITE
    mujoco.mju_mat2Quat(quaternion, data.site_xmat[scene.tip_site])
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    # At the tip, along the axes of the world, which are those of the nominal socket.
    mujoco.mj_objectVelocity(scene.model, data, site, scene.tip_site, twist, 0)
    return data.site_xpos[scene.tip_site] - scene.nominal, vector, twist[3:], twist[:3]


def test_an_observation_holds_what_its_table_says_in_its_scale(scene, world, fresh, links):
    action = jax.random.uniform(KEY, (COUNT, 6), minval=-1, maxval=1)
    state, _ = world.step(fresh, action, KEY)
    obs = np.asarray(state.obs)
    assert obs.shape == (COUNT, 29) and observation.OBS_SIZE == 29
    rest = np.asarray(env.rest_posture(links))
    target = env.setpoint(OPTIONS.mdp, fresh.tip, action)
    for i in range(COUNT):
        position, vector, velocity, angular = measured(scene, state.physics, i)
        np.testing.assert_allclose(obs[i, :7] * 0.1, state.physics.qpos[i] - rest, atol=1e-6)
        np.testing.assert_allclose(obs[i, 7:14] * 0.5, state.physics.qvel[i], atol=1e-6)
        np.testing.assert_allclose(obs[i, 14:17] * 0.03, position, atol=2e-6)
        np.testing.assert_allclose(obs[i, 17:20] * 0.1, vector, atol=1e-5)
        np.testing.assert_allclose(obs[i, 20:23] * 0.1, velocity, atol=1e-6)
        np.testing.assert_allclose(obs[i, 23:26] * 0.5, angular, atol=1e-5)
        np.testing.assert_allclose(obs[i, 26:] * 0.01, target[i, :3] - position, atol=2e-6)


def test_the_pose_in_an_observation_is_where_its_slice_says(world, fresh):
    pose = fresh.obs[:, observation.TIP_POSE] * observation.POSE_SCALE
    np.testing.assert_allclose(pose, fresh.tip, atol=1e-6)


def test_the_middle_of_the_start_cube_at_rest_is_observed_as_nearly_zero(links, at_rest):
    physics = at_rest([[0.0, 0.0, 0.04]])
    rest = np.asarray(env.rest_posture(links))
    obs = np.asarray(env.observe(links, rest, physics, jnp.zeros((1, 3)))[1])[0]
    np.testing.assert_allclose(np.delete(obs, 16), 0, atol=2e-3)
    np.testing.assert_allclose(obs[16], 0.04 / 0.03, atol=1e-3)


def test_observations_are_clipped(links, at_rest):
    physics = at_rest([[0.0, 0.0, 0.04]])
    wild = physics.replace(qvel=physics.qvel + jnp.array([1e6, *[0.0] * 6]))
    obs = env.observe(links, np.zeros(7), wild, jnp.zeros((1, 3)))[1]
    assert float(jnp.abs(obs).max()) == 10.0


def test_observations_are_blind_to_the_offset_of_the_socket(world, fresh):
    # Well above the mouth, where no contact gives the offset away.
    high = rows(fresh, np.asarray(fresh.tip[:, 2]) > 0.03)
    assert len(high.age) > 3
    count = len(high.age)
    moved = high.replace(
        around=high.around.replace(socket_offset=np.float32(0.004) * np.ones((count, 2), "f"))
    )
    action = jax.random.uniform(KEY, (count, 6), minval=-1, maxval=1)
    np.testing.assert_array_equal(
        world.step(high, action, KEY)[1].next_obs, world.step(moved, action, KEY)[1].next_obs
    )


# Start of an episode


def test_a_reset_starts_at_rest_in_the_cube_above_the_mouth(world):
    state = world.reset(jax.random.key(3), 512)
    low, high = np.array([-0.03, -0.03, 0.01]), np.array([0.03, 0.03, 0.07])
    position = np.asarray(state.tip[:, :3])
    assert (position > low - 1e-5).all() and (position < high + 1e-5).all()
    assert (position.max(axis=0) - position.min(axis=0) > 0.055).all(), "hardly fills the cube"
    np.testing.assert_allclose(state.tip[:, 3:], 0, atol=1e-4)
    assert not np.any(state.physics.qvel) and not np.any(state.age)
    assert not np.any(state.obs[:, 26:]), "a setpoint before the first action"
    assert np.abs(state.around.socket_offset).max() <= 4e-3
    assert (state.around.shape == 2).all() and (state.around.friction == 1.0).all()


def test_an_ended_episode_gives_its_last_observation_and_starts_afresh(world, nearly_in):
    after, outcome = world.step(nearly_in, DOWN, KEY)
    assert outcome.terminated.all()
    assert (outcome.next_obs[:, 16] * 0.03 < -env.SUCCESS_DEPTH).all()
    pose = outcome.next_obs[:, observation.TIP_POSE] * observation.POSE_SCALE
    np.testing.assert_allclose(outcome.tip, pose, atol=1e-6)
    assert equal(after, world.reset(KEY, COUNT))
    assert (after.obs[:, 16] > 0.009 / 0.03).all()


def test_the_offset_is_drawn_anew_at_each_start(world, nearly_in):
    first, _ = world.step(nearly_in, DOWN, jax.random.key(1))
    second, _ = world.step(nearly_in, DOWN, jax.random.key(2))
    drawn = [s.around.socket_offset for s in (nearly_in, first, second)]
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert (np.abs(drawn[one] - drawn[other]).max(axis=1) > 0).all()


def test_an_episode_that_goes_on_keeps_its_surroundings(world, fresh):
    after, outcome = world.step(fresh, STILL, KEY)
    assert not np.any(outcome.terminated | outcome.truncated)
    assert equal(after.around, fresh.around)
    np.testing.assert_array_equal(after.obs, outcome.next_obs)
    np.testing.assert_array_equal(after.age, 1)


# End of an episode


def test_full_insertion_terminates_with_reward_one(world, nearly_in):
    _, outcome = world.step(nearly_in, DOWN, KEY)
    assert outcome.terminated.all() and not outcome.truncated.any()
    np.testing.assert_array_equal(outcome.reward, 1.0)


def test_hovering_gives_nothing(world, nearly_in):
    _, outcome = world.step(nearly_in, STILL, KEY)
    assert not np.any(outcome.terminated | outcome.truncated | (outcome.reward != 0))


@pytest.mark.parametrize(
    ("tip", "success"),
    [
        ((0.0, 0.0, -0.0286), True),
        ((0.0, 0.0, -0.0284), False),
        ((0.0029, 0.0, -0.0286), True),
        ((0.0031, 0.0, -0.0286), False),
        ((0.0, -0.0031, -0.0286), False),
    ],
)
def test_success_is_the_tip_at_the_bottom_of_its_own_socket(around, tip, success):
    offset = jnp.array([2e-3, -1e-3])
    position = jnp.array([tip]) + jnp.array([*offset, 0.0])
    pose = jnp.concatenate([position, jnp.zeros((1, 3))], axis=1)
    assert bool(env.inserted(pose, around([0], offset))[0]) is success


def test_the_fiftieth_step_truncates_and_no_other(world, fresh):
    state, key = fresh, KEY
    up = jnp.zeros((COUNT, 6)).at[:, 2].set(1.0)
    for step in range(1, 52):
        state, outcome = world.step(state, up, key)
        assert (outcome.truncated == (step == 50)).all()
        assert not np.any(outcome.terminated)
    np.testing.assert_array_equal(state.age, 1)


def test_insertion_at_the_last_step_terminates_and_does_not_truncate(world, nearly_in):
    last = nearly_in.replace(age=jnp.full(COUNT, 49, jnp.int32))
    _, outcome = world.step(last, DOWN, KEY)
    assert outcome.terminated.all() and not outcome.truncated.any()


def test_the_horizon_is_an_option(make):
    short = make(dataclasses.replace(OPTIONS, mdp=config.Mdp(horizon=2)))
    state = short.reset(KEY, COUNT)
    state, outcome = short.step(state, STILL, KEY)
    assert not outcome.truncated.any()
    assert short.step(state, STILL, KEY)[1].truncated.all()


def test_a_broken_simulation_ends_its_own_episode_without_reward(world, nearly_in):
    broken = nearly_in.physics.qvel.at[4].set(jnp.nan)
    hurt = nearly_in.replace(physics=nearly_in.physics.replace(qvel=broken))
    action = jnp.where(jnp.arange(COUNT)[:, None] % 2 == 0, DOWN, STILL)
    after, outcome = world.step(hurt, action, KEY)
    np.testing.assert_array_equal(outcome.finite, np.arange(COUNT) != 4)
    assert not (outcome.terminated[4] or outcome.truncated[4]) and outcome.reward[4] == 0
    assert equal(rows(after, 4), rows(world.reset(KEY, COUNT), 4))
    others = np.arange(COUNT) != 4
    whole = world.step(nearly_in, action, KEY)
    assert equal(rows((after, outcome), others), rows(whole, others))


def test_a_broken_simulation_at_the_time_limit_is_not_a_truncation(world, fresh):
    broken = fresh.replace(
        physics=fresh.physics.replace(qpos=fresh.physics.qpos.at[0, 3].set(jnp.inf)),
        age=jnp.full(COUNT, 49, jnp.int32),
    )
    _, outcome = world.step(broken, STILL, KEY)
    np.testing.assert_array_equal(outcome.truncated, np.arange(COUNT) != 0)
    assert not outcome.finite[0]


# Action


def test_a_setpoint_is_the_measured_pose_moved_by_the_action():
    tip = jnp.array([[0.01, -0.02, 0.03, 0.01, 0.02, -0.03]])
    action = jnp.array([[1.0, -0.5, 0.25, 1.0, -1.0, 0.5]])
    expected = [[0.02, -0.025, 0.0325, 0.06, -0.03, -0.005]]
    np.testing.assert_allclose(env.setpoint(config.Mdp(), tip, action), expected, atol=1e-7)


def test_setpoints_stay_in_their_box():
    far = jnp.array([[1.0] * 6, [-1.0] * 6])
    low, high = (-0.04, -0.04, -0.04, *[-0.15] * 3), (0.04, 0.04, 0.08, *[0.15] * 3)
    np.testing.assert_allclose(env.setpoint(config.Mdp(), far, 0 * far), [high, low], atol=1e-7)


def test_actions_beyond_one_count_as_one(world, fresh):
    action = jax.random.normal(KEY, (COUNT, 6))
    big = jnp.sign(action) * jnp.maximum(jnp.abs(action), 1.0) * 1000
    assert equal(world.step(fresh, big, KEY), world.step(fresh, jnp.sign(action), KEY))


@pytest.mark.parametrize("axis", range(6))
def test_each_action_moves_the_tip_along_its_own_axis(world, fresh, axis):
    high = rows(fresh, np.asarray(fresh.tip[:, 2]) > 0.03)
    action = jnp.zeros((len(high.age), 6)).at[:, axis].set(1.0)
    moved = np.asarray(world.step(high, action, KEY)[1].tip - high.tip)
    assert (moved[:, axis] > (1e-3 if axis < 3 else 3e-3)).all()
    scaled = np.abs(moved) / ([0.01] * 3 + [0.05] * 3)
    assert (scaled.argmax(axis=1) == axis).all()


# Reward and determinism


def test_another_reward_changes_nothing_but_the_reward(make, world, fresh):
    dense = make(OPTIONS, dense_reward)
    state, outcome = world.step(fresh, DOWN, KEY)
    other_state, other = dense.step(fresh, DOWN, KEY)
    assert equal(state, other_state)
    assert equal(outcome, other.replace(reward=outcome.reward))
    assert (other.reward < 0).all()


def test_equal_keys_give_equal_episodes_and_others_do_not(world, nearly_in):
    assert equal(world.reset(KEY, COUNT), world.reset(KEY, COUNT))
    one, same = world.step(nearly_in, DOWN, KEY), world.step(nearly_in, DOWN, KEY)
    assert equal(one, same)
    other_state, other = world.step(nearly_in, DOWN, jax.random.key(8))
    assert equal(one[1], other), "the key changes the step itself"
    assert not equal(one[0], other_state)
