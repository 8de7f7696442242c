"""What a real arm adds: late actions, wrong encoders, noisy readings, and success judged truly."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from crsfd_jax import config, env, evaluate, observation, task
from crsfd_jax.errors import UserError
from crsfd_jax.options.randomisation import HELD_OUT, TRAINING, Randomisation
from crsfd_jax.options.run_name import run_name
from crsfd_jax.scene import digits, kinematics
from crsfd_jax.storage import artefacts

COUNT = 16
OPTIONS = config.Config(shape="2", shift=2e-3, engine="native")
KEY = jax.random.key(3)
STILL = jnp.zeros((COUNT, 6))


@pytest.fixture(scope="module")
def world():
    """(changes of the randomisation, of the MDP) -> the environment with compiled functions."""
    made = {}

    def compiled(horizon=50, **changes):
        mark = (horizon, *sorted(changes.items()))
        if mark not in made:
            mdp = config.Mdp(horizon=horizon)
            arm = Randomisation(**changes)
            built = task.make_env(dataclasses.replace(OPTIONS, mdp=mdp, randomisation=arm))
            step, reset = jax.jit(built.step), jax.jit(built.reset, static_argnums=1)
            made[mark] = built._replace(step=step, reset=reset)
        return made[mark]

    return compiled


def actions(steps, seed=0):
    """[T, N, 6] moves that stay above the mouth."""
    drawn = np.random.default_rng(seed).uniform(-1, 1, (steps, COUNT, 6))
    drawn[..., 2] = np.abs(drawn[..., 2])
    return jnp.asarray(drawn, jnp.float32)


def rolled(made, commands, key=KEY):
    """States after a reset and after each action."""
    states = [made.reset(key, COUNT)]
    for action in commands:
        states.append(made.step(states[-1], action, key)[0])
    return states


def equal(one, other):
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


def test_without_randomisation_a_step_is_setpoint_physics_and_observation(world, links):
    made, action = world(), actions(1)[0]
    physics, _ = task.engine("native", OPTIONS.scene)
    rest = np.asarray(env.rest_posture(links))

    @jax.jit
    def plain(state, action):
        target = env.setpoint(OPTIONS.mdp, state.tip, action)
        moved = physics.step(state.physics, state.around, target)
        error = target[:, :3] - kinematics.tip_pose(links, moved.qpos)[0]
        return moved, env.observe(links, rest, moved, error)

    before = made.reset(KEY, COUNT)
    after, outcome = made.step(before, action, KEY)
    moved, (tip, obs) = plain(before, action)
    assert equal(after.physics, moved)
    np.testing.assert_array_equal(after.obs, obs)
    np.testing.assert_array_equal(after.tip, tip)
    np.testing.assert_array_equal(outcome.tip, tip)
    assert after.commanded is None


def test_a_delayed_setpoint_is_held_one_step_later(world, links):
    physics, _ = task.engine("native", OPTIONS.scene)
    moved = jax.jit(physics.step)
    states, commands = rolled(world(delay=1.0), actions(4)), actions(4)
    sent = [env.setpoint(OPTIONS.mdp, states[0].tip, STILL)]
    for before, after, action in zip(states, states[1:], commands, strict=False):
        expected = moved(before.physics, before.around, sent[-1])
        np.testing.assert_allclose(after.physics.qpos, expected.qpos, atol=1e-6)
        # What is told is what the robot's program knows: the setpoint that it sent last.
        sent.append(env.setpoint(OPTIONS.mdp, before.tip, action))
        error = sent[-1][:, :3] - after.tip[:, :3]
        np.testing.assert_allclose(after.obs[:, -3:] * 0.01, error, atol=1e-6)
    assert np.abs(sent[2] - sent[1]).max() > 5e-3, "each command is another"


def test_a_delayed_episode_begins_without_an_action_of_the_one_before(world):
    commands = actions(4)
    late = rolled(world(horizon=2, delay=1.0), commands)
    assert (late[2].age == 0).all()
    fresh = rolled(world(horizon=2, delay=1.0), commands[2:])
    for one, other in zip(late[2:], fresh, strict=True):
        assert equal(one, other)


def test_only_delayed_environments_are_late(world):
    made, commands = world(delay=0.5), actions(2)
    some, prompt, late = (rolled(w, commands) for w in (made, world(), world(delay=1.0)))
    is_delayed = np.asarray(some[0].around.is_delayed)
    assert 0 < is_delayed.sum() < COUNT
    for mixed, one, other in zip(some, prompt, late, strict=True):
        expected = np.where(is_delayed[:, None], other.physics.qpos, one.physics.qpos)
        np.testing.assert_array_equal(mixed.physics.qpos, expected)


def test_encoders_are_off_by_the_same_angles_all_episode(world, links):
    made = world(encoder_offset=(-5e-3, 5e-3))
    rest = np.asarray(env.rest_posture(links))
    first, *_, last = rolled(made, actions(3))
    offset = first.around.encoder_offset
    assert 4e-3 < float(jnp.abs(offset).max()) <= 5e-3
    for state in (first, last):
        read = state.physics.qpos + offset
        np.testing.assert_allclose(state.obs[:, :7] * 0.1, read - rest, atol=1e-6)
        np.testing.assert_allclose(state.tip, kinematics.pose(links, read), atol=1e-6)
        pose = state.obs[:, observation.TIP_POSE] * observation.POSE_SCALE
        np.testing.assert_allclose(pose, state.tip, atol=1e-6)
    assert equal(first.physics, world().reset(KEY, COUNT).physics)


def test_wrong_encoders_pull_the_arm_nowhere(world):
    """The controller reads them too, so an arm that is told to stay stays."""
    first, *_, last = rolled(world(encoder_offset=(-5e-3, 5e-3)), [STILL] * 5)
    assert float(jnp.abs(last.physics.qpos - first.physics.qpos).max()) < 2e-5


def test_wrong_encoders_move_by_the_action_from_where_the_arm_is(world, links):
    up = STILL.at[:, 2].set(0.5)
    moves = []
    for changes in ({}, {"encoder_offset": (-5e-3, 5e-3)}):
        states = rolled(world(**changes), [up] * 3)
        ends = [kinematics.pose(links, states[i].physics.qpos) for i in (0, -1)]
        moves.append(np.asarray(ends[1] - ends[0]))
    assert moves[0][:, 2].min() > 5e-3
    np.testing.assert_allclose(moves[0], moves[1], atol=3e-4)


def readings(made, links, count=2000):
    """[count, 6] error of the measured pose at a reset, and the state."""
    state = made.reset(jax.random.key(1), count)
    return np.asarray(state.tip - kinematics.pose(links, state.physics.qpos)), state


def test_readings_have_the_noise_that_was_asked_for(world, links):
    error, state = readings(world(position_noise=2e-4, rotation_noise=3e-3), links)
    np.testing.assert_allclose(error.std(axis=0), [2e-4] * 3 + [3e-3] * 3, rtol=0.06)
    assert (np.abs(error.mean(axis=0)) < [2e-5] * 3 + [3e-4] * 3).all()
    assert np.abs(np.corrcoef(error.T) - np.eye(6)).max() < 0.08
    pose = state.obs[:, observation.TIP_POSE] * observation.POSE_SCALE
    np.testing.assert_allclose(pose, state.tip, atol=1e-6)
    error, _ = readings(world(rotation_noise=3e-3), links)
    assert np.abs(error[:, :3]).max() < 1e-6


def test_noise_changes_readings_and_setpoints_but_no_physics(world, links):
    made, action = world(position_noise=2e-4, rotation_noise=1e-3), actions(1)[0]
    before, after = rolled(made, [action])
    plain = world().reset(KEY, COUNT)
    assert equal(before.physics, plain.physics)
    np.testing.assert_array_equal(before.obs[:, :14], plain.obs[:, :14])
    target = env.setpoint(OPTIONS.mdp, before.tip, action)
    physics, _ = task.engine("native", OPTIONS.scene)
    moved = jax.jit(physics.step)(before.physics, before.around, target)
    np.testing.assert_allclose(after.physics.qpos, moved.qpos, atol=1e-6)
    error = np.asarray(target[:, :3] - after.tip[:, :3])
    np.testing.assert_allclose(after.obs[:, 26:] * 0.01, error, atol=1e-6)


def test_each_reading_has_noise_of_its_own_and_the_same_again_for_the_same_key(world, links):
    made = world(position_noise=2e-4, rotation_noise=1e-3)
    states = rolled(made, [STILL] * 3)
    poses = [kinematics.pose(links, state.physics.qpos) for state in states]
    errors = np.stack([state.tip - pose for state, pose in zip(states, poses, strict=True)])
    flat = errors.reshape(len(states) * COUNT, 6)
    assert len(np.unique(flat[:, 0])) == len(flat)
    assert np.abs(np.corrcoef(errors.reshape(len(states), -1)) - np.eye(len(states))).max() < 0.4
    assert equal(states[-1], rolled(made, [STILL] * 3)[-1])


@pytest.mark.parametrize("turned", [True, False])
def test_a_turned_socket_takes_a_peg_that_is_turned_as_far(world, at_rest, turned):
    made = world(socket_yaw=(0.06, 0.08))
    state = made.reset(KEY, COUNT)
    around = state.around
    position = np.column_stack([around.socket_offset, np.full(COUNT, 2e-3)])
    rotation = np.zeros((COUNT, 3), np.float32)
    if turned:
        rotation[:, 2] = around.socket_yaw
    tip = jnp.asarray(np.column_stack([position, rotation]), jnp.float32)
    state = state.replace(physics=at_rest(position, rotation), tip=tip)
    down, inserted = STILL.at[:, 2].set(-1.0), np.zeros(COUNT, bool)
    for _ in range(10):
        state, outcome = made.step(state, down, KEY)
        inserted |= np.asarray(outcome.terminated)
    assert inserted.all() if turned else not inserted.any()


def test_observations_do_not_tell_the_socket_gains_friction_or_delay(world):
    plain = world().reset(KEY, COUNT)
    arm = {"stiffness": (0.5, 1.5), "damping": (0.5, 1.5), "socket_yaw": (-0.1, 0.1)}
    hidden = world(**arm, friction=(0.5, 2.0), delay=0.5)
    np.testing.assert_array_equal(hidden.reset(KEY, COUNT).obs, plain.obs)


@pytest.mark.parametrize("depth", [1e-3, -4e-3])
def test_success_is_judged_by_the_true_pose(world, at_rest, depth):
    made = world(position_noise=1e-2, encoder_offset=(-5e-3, 5e-3))
    state = made.reset(KEY, COUNT)
    offset = np.asarray(state.around.socket_offset)
    height = np.full(COUNT, -env.SUCCESS_DEPTH - depth)
    place = at_rest(np.column_stack([offset, height]))
    tip = jnp.asarray(np.column_stack([offset, height, np.zeros((COUNT, 3))]), jnp.float32)
    _, outcome = made.step(state.replace(physics=place, tip=tip), STILL, KEY)
    assert (outcome.terminated == (depth > 0)).all()
    np.testing.assert_allclose(outcome.tip[:, 2], height, atol=1.2e-3)
    seen = outcome.next_obs[:, 16] * 0.03
    assert len({bool(z) for z in seen < -env.SUCCESS_DEPTH}) == 2, "the noise hides nothing"
    np.testing.assert_array_equal(outcome.reward, outcome.terminated)


def test_everything_at_once_runs_and_stays_finite(world):
    made = world(**vars(TRAINING))
    down = STILL.at[:, 2].set(-1.0)
    for state in rolled(made, [down] * 20):
        assert np.isfinite(state.obs).all()
    assert digits.HOLE_DEPTH + float(state.tip[:, 2].min()) > -2e-3


# Which randomisation an evaluation draws from


@pytest.fixture
def run_folder(tmp_path):
    own = dataclasses.replace(OPTIONS, randomisation=TRAINING, shape="0,2")
    with artefacts.open_run(tmp_path / "run", own, "here", []):
        return str(tmp_path / "run")


def test_an_evaluation_is_that_of_the_run_unless_it_is_told_otherwise(run_folder):
    given, own, asked = evaluate.task_of([run_folder, "--episodes", "500"])
    assert (own.randomisation, own.shape, own.shift) == (TRAINING, "0,2", 2e-3)
    assert given.episodes == 500 and asked == "--episodes 500"
    _, other, asked = evaluate.task_of([run_folder, "--held-out", "--shape", "0,2"])
    assert other.randomisation == HELD_OUT and asked == "--held-out"


def test_an_option_of_an_evaluation_changes_nothing_but_itself(run_folder):
    line = [run_folder, "--randomisation.stiffness", "0.5", "0.6", "1", "1.2", "--shape", "all"]
    _, changed, _ = evaluate.task_of(line)
    assert changed.shape == "all" and changed.shift == 2e-3
    own = dataclasses.replace(TRAINING, stiffness=(0.5, 0.6, 1.0, 1.2))
    assert changed.randomisation == own
    off = ["--randomisation.encoder-offset", "-0.002", "-0.001", "--held-out"]
    _, changed, _ = evaluate.task_of([run_folder, *off])
    assert changed.randomisation == dataclasses.replace(HELD_OUT, encoder_offset=(-2e-3, -1e-3))


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("--randomisation.friction 1", "got 1, allowed: low high"),
        ("--randomisation.friction 2 1", "got 2 1, allowed: low high"),
        ("--randomisation.friction 1 2 2 3", "got 1 2 2 3, allowed: low high"),
        ("--randomisation.friction 0 1", "got 0, allowed: above 0 and at most 10"),
        ("--randomisation.friction", "got no number"),
        ("--randomisation.delay 2", "got 2, allowed: at least 0 and at most 1"),
        ("--randomisation.position-noise 1", "got '1', allowed: a non-negative number with"),
        ("--randomisation.position-noise 5cm", "got 50mm, allowed: at least 0mm and at most 10mm"),
        ("--shift 1m", "--shift: got 1000mm, allowed: at least 0mm and at most 20mm"),
        ("--shape 7", "--shape: got '7', allowed: 0, 1, 2, 3, 4"),
        ("--csv /proc/x/table.csv", "--csv: got '/proc/x/table.csv', which cannot be written"),
    ],
)
def test_an_unusable_option_of_an_evaluation_is_refused(run_folder, line, answer):
    with pytest.raises(UserError) as error:
        evaluate.task_of([run_folder, *line.split()])
    assert answer in str(error.value) and "\n" not in str(error.value)


def test_randomised_runs_have_folders_of_their_own():
    assert run_name(OPTIONS) == "crsfd-shape2-shift2mm-seed0x5"
    randomised = dataclasses.replace(OPTIONS, randomisation=TRAINING)
    assert run_name(randomised) == "crsfd-shape2-shift2mm-randomised-seed0x5"
