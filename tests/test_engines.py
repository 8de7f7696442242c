"""The engines agree, and what may differ between environments matters to each of them.

MJX computes in float32 and stops the same solver after the same few iterations elsewhere, and it
keeps at most `max_contact_points` contacts. Without contact that leaves micrometres after six
control steps. In contact most environments agree as closely, but a peg that jams or just slips can
come out 0.5 mm apart, half the clearance, so the median has a limit as well as the largest one.
"""

import importlib.util
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from crsfd_jax import config, env
from crsfd_jax.errors import UserError
from crsfd_jax.physics import mjx, native, select
from crsfd_jax.scene import build, digits, kinematics

COUNT = 60
"""Environments: five shapes in each of four situations, three times."""
SITUATION = np.arange(COUNT) // 5 % 4
FREE, RIM, HOLE, WALL = range(4)


class Rolled(NamedTuple):
    """T control steps of N environments."""

    joints: np.ndarray
    """[T, N, 7] rad."""
    tips: np.ndarray
    """[T, N, 6] m and rad."""
    targets: np.ndarray
    """[T, N, 6] setpoints, m and rad."""


def repeated(engine, state, surroundings, targets):
    """[T, N, 7] joint angles under given setpoints."""
    joints = []
    for target in targets:
        state = engine.step(state, surroundings, target)
        joints.append(np.asarray(state.qpos))
    return np.stack(joints)


@pytest.fixture(scope="module")
def mixed(at_rest, around):
    """(state, surroundings, action): free, on the rim, falling in the hole, pressing its walls."""
    rng = np.random.default_rng(0)
    offset = rng.uniform(-4e-3, 4e-3, (COUNT, 2))
    spread = np.array([0.03, 0.008, 3e-4, 0.0])[SITUATION]
    low = np.array([0.03, 0.002, -0.025, -0.025])[SITUATION]
    high = np.array([0.06, 0.002, -0.005, -0.005])[SITUATION]
    beside = offset + spread[:, None] * rng.uniform(-1, 1, (COUNT, 2))
    position = np.column_stack([beside, rng.uniform(low, high)])
    tilt = np.where(SITUATION == RIM, 0.05, 0.0)[:, None] * rng.uniform(-1, 1, (COUNT, 3))
    action = rng.uniform(-1, 1, (COUNT, 6))
    action[SITUATION == RIM, 2] = -1
    action[SITUATION == HOLE] = (0, 0, -1, 0, 0, 0)
    action[SITUATION == WALL] = np.sign(action[SITUATION == WALL])
    action[SITUATION == FREE, 2] = np.abs(action[SITUATION == FREE, 2])
    friction = rng.uniform(0.3, 1.2, COUNT)
    gains = np.where(np.arange(COUNT)[:, None] % 3, rng.uniform(0.8, 1.2, (COUNT, 2)), 1.0)
    yaw = rng.uniform(-0.05, 0.05, COUNT)
    tilt[:, 2] = np.where(np.isin(SITUATION, (HOLE, WALL)), yaw, tilt[:, 2])
    surroundings = around(np.arange(COUNT) % 5, offset, friction, gains, yaw)
    return at_rest(position, tilt), surroundings, action


@pytest.fixture(scope="module")
def roll(links):
    """(engine, state, surroundings, action) -> joint angles, tips and setpoints of each step."""

    @jax.jit
    def tip_of(qpos):
        position, rotation, _ = kinematics.tip_pose(links, qpos)
        return jnp.concatenate([position, kinematics.rotation_vector(rotation)], axis=-1)

    def run(engine, state, surroundings, action, steps=6):
        rows = []
        for _ in range(steps):
            target = env.setpoint(config.Mdp(), tip_of(state.qpos), jnp.asarray(action))
            state = engine.step(state, surroundings, target)
            rows.append((state.qpos, tip_of(state.qpos), target))
        return Rolled(*map(np.stack, zip(*rows, strict=True)))

    return run


@pytest.fixture(scope="module")
def native_roll(roll, native_engine, mixed):
    return roll(native_engine, *mixed)


@pytest.fixture(scope="module")
def mjx_roll(roll, mjx_engine, mixed):
    return roll(mjx_engine, *mixed)


def apart(one, other):
    """Distance (m) and angle (rad) between tips [N, 6]."""
    return np.linalg.norm((one - other).reshape(-1, 2, 3), axis=2).T


def test_the_situations_are_what_their_names_say(native_roll, mixed):
    _, around, _ = mixed
    relative = native_roll.tips[-1, :, :3] - np.pad(around.socket_offset, ((0, 0), (0, 1)))
    assert (relative[SITUATION == FREE, 2] > 0.01).all()
    assert (np.abs(relative[SITUATION == RIM, 2]) < 0.01).all()
    assert (relative[SITUATION == HOLE, 2] < -0.028).all()
    assert (np.abs(relative[SITUATION == WALL, :2]) < 5e-3).all()


@pytest.mark.parametrize("steps", [1, 6])
def test_mjx_moves_a_free_arm_as_native_does(native_roll, mjx_roll, steps):
    free = SITUATION == FREE
    moved, turned = apart(native_roll.tips[steps - 1, free], mjx_roll.tips[steps - 1, free])
    assert moved.max() < 5e-6 and turned.max() < 2e-5


@pytest.mark.parametrize("situation", [RIM, HOLE, WALL])
@pytest.mark.parametrize("steps", [1, 6])
def test_mjx_agrees_with_native_in_contact(native_roll, mjx_roll, situation, steps):
    rows = np.isin(SITUATION, situation)
    moved, turned = apart(native_roll.tips[steps - 1, rows], mjx_roll.tips[steps - 1, rows])
    assert np.median(moved) < 5e-5 and np.median(turned) < 5e-4
    assert moved.max() < 0.75e-3 and turned.max() < 7e-3


def only(tree, rows):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[rows], tree)


@pytest.mark.parametrize("shape", range(5))
def test_a_mixed_batch_equals_separate_runs_of_models_of_one_shape(native_roll, mixed, shape):
    """Bit by bit: no shape, place, friction or gain leaks into another environment."""
    state, surroundings, _ = mixed
    rows = np.arange(COUNT) % 5 == shape
    alone = native.make(build.build(config.Scene(), (config.SHAPES[shape],)))
    own = only(surroundings, rows).replace(shape=jnp.zeros(rows.sum(), jnp.int32))
    joints = repeated(alone, only(state, rows), own, native_roll.targets[:, rows])
    np.testing.assert_array_equal(joints, native_roll.joints[:, rows])


@pytest.mark.parametrize("row", [0, RIM * 5 + 2, HOLE * 5, WALL * 5 + 4])
def test_an_environment_does_not_notice_its_neighbours(native_engine, native_roll, mixed, row):
    state, surroundings, _ = mixed
    alone = np.array([row])
    targets = native_roll.targets[:, alone]
    joints = repeated(native_engine, only(state, alone), only(surroundings, alone), targets)
    np.testing.assert_array_equal(joints, native_roll.joints[:, alone])


def test_the_past_of_a_batch_does_not_matter(native_engine, native_roll, mixed):
    state, surroundings, _ = mixed
    other = np.roll(np.arange(COUNT), 7)
    repeated(native_engine, only(state, other), only(surroundings, other), -native_roll.targets)
    joints = repeated(native_engine, state, surroundings, native_roll.targets)
    np.testing.assert_array_equal(joints, native_roll.joints)


def test_leading_axes_of_a_vmap_are_more_environments(native_engine, mixed):
    state, surroundings, action = mixed
    target = jnp.asarray(action, jnp.float32) * 0.01
    flat = native_engine.step(state, surroundings, target)
    split = jax.tree.map(lambda x: x.reshape(3, 4, 5, *x.shape[1:]), (state, surroundings, target))
    nested = jax.vmap(jax.vmap(native_engine.step))(*split)
    for a, b in zip(jax.tree.leaves(flat), jax.tree.leaves(nested), strict=True):
        np.testing.assert_array_equal(a, b.reshape(a.shape))


@pytest.fixture(params=["native", "mjx"])
def engine(request):
    return request.getfixturevalue(f"{request.param}_engine")


def fallen(engine, at_rest, surroundings):
    """[N, 7] joint angles of pegs pushed down and sideways from half a millimetre above."""
    state = at_rest(np.tile([0.0, 0.0, 5e-4], (COUNT, 1)))
    target = jnp.tile(jnp.array([0.01, 0.004, -0.02, 0.0, 0.0, 0.0]), (COUNT, 1))
    for _ in range(3):
        state = engine.step(state, surroundings, target)
    return np.asarray(state.qpos)


def differing(engine, at_rest, around, **changes):
    """bool [N]: whose motion a change of the surroundings of every odd environment alters."""
    same = {"shape": np.zeros(COUNT), "offset": np.zeros((COUNT, 2)), "friction": np.ones(COUNT)}
    same["gains"] = np.ones((COUNT, 2))
    odd = np.arange(COUNT) % 2 == 1
    mixed = dict(same)
    for name, value in changes.items():
        mixed[name] = np.where(odd.reshape(-1, *[1] * (same[name].ndim - 1)), value, same[name])
    before, after = (fallen(engine, at_rest, around(**kwargs)) for kwargs in (same, mixed))
    np.testing.assert_array_equal(before[~odd], after[~odd])
    return (np.abs(before - after).max(axis=1) > 1e-4)[odd]


@pytest.mark.parametrize(
    "changes",
    [
        {"shape": 4},
        {"offset": (3e-3, 0.0)},
        {"offset": (0.0, -3e-3)},
        {"friction": 0.1},
        {"gains": (0.3, 1.0)},
        {"gains": (1.0, 3.0)},
    ],
)
def test_shape_offset_friction_and_gains_change_their_own_environment_only(
    engine, at_rest, around, changes
):
    assert differing(engine, at_rest, around, **changes).all()


def scaled(scene, stiffness, damping):
    """The model of a controller with other gains, by its own definition."""
    model = scene.model.__copy__()
    stiffness = stiffness * model.actuator_gainprm[:, 0]
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1] = stiffness, -stiffness
    model.actuator_biasprm[:, 2] *= damping
    return model


@pytest.mark.parametrize("gains", [(1.0, 1.0), (0.5, 1.0), (1.25, 0.5)])
def test_gains_are_those_of_the_controller_and_set_its_steady_force(
    scene, at_rest, around, native_engine, gains
):
    """A peg that is pressed on the floor of its hole, against MuJoCo alone."""
    stiffness, depth = np.float32(gains[0]), 6e-3
    state = at_rest([[0.0, 0.0, -digits.HOLE_DEPTH + 1e-3]])
    model = scaled(scene, *gains)
    data = mujoco.MjData(model)
    data.qpos[:] = state.qpos[0]
    target = np.array([[0.0, 0.0, -digits.HOLE_DEPTH - depth, 0.0, 0.0, 0.0]], np.float32)
    data.ctrl[:] = target[0]
    for _ in range(10):
        state = native_engine.step(state, around([0], gains=gains), jnp.asarray(target))
        mujoco.mj_step(model, data, 20)
        np.testing.assert_allclose(state.qpos[0], data.qpos, atol=2e-6)
    np.testing.assert_allclose(data.actuator_force[2], -1000 * stiffness * depth, rtol=0.03)


def test_no_gains_are_gains_of_one(native_engine, mjx_engine, mixed):
    state, surroundings, action = mixed
    target = jnp.asarray(action, jnp.float32) * 0.01
    ones = native_engine.step(state, surroundings.replace(gains=jnp.ones((COUNT, 2))), target)
    none = native_engine.step(state, surroundings.replace(gains=None), target)
    for a, b in zip(jax.tree.leaves(ones), jax.tree.leaves(none), strict=True):
        np.testing.assert_array_equal(a, b)
    args = state, surroundings.replace(gains=None), target
    assert jax.eval_shape(mjx_engine.step, *args).qpos.shape == (COUNT, 7)


def test_a_broken_simulation_gives_nan_and_leaves_the_others_bit_equal(engine, mixed):
    state, surroundings, action = mixed
    target = jnp.asarray(action, jnp.float32) * 0.01
    broken = state.replace(qvel=state.qvel.at[7].set(jnp.nan))
    whole, hurt = (engine.step(s, surroundings, target) for s in (state, broken))
    others = np.arange(COUNT) != 7
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(hurt), strict=True):
        np.testing.assert_array_equal(np.asarray(a)[others], np.asarray(b)[others])
    assert np.isnan(hurt.qpos[7]).any()


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """An empty working folder, where MuJoCo would write its log of warnings."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_an_engine_recovers_from_a_broken_simulation(native_engine, mixed, elsewhere):
    state, surroundings, action = mixed
    target = jnp.asarray(action, jnp.float32) * 0.01
    before = native_engine.step(state, surroundings, target)
    for poison in (jnp.nan, jnp.inf, 1e30):
        native_engine.step(state.replace(qvel=state.qvel + poison), surroundings, target)
        after = native_engine.step(state, surroundings, target)
        for a, b in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
            np.testing.assert_array_equal(a, b)
    assert not list(elsewhere.iterdir())


def test_mujoco_never_sees_a_state_that_is_already_broken(native_engine, mixed, elsewhere):
    """It would warn about it in a file in the working folder."""
    some = np.arange(11)  # A batch of its own: each simulation warns only once.
    state, surroundings = only(mixed[0], some), only(mixed[1], some)
    broken = state.replace(qpos=state.qpos.at[2, 0].set(jnp.nan))
    after = native_engine.step(broken, surroundings, jnp.zeros((11, 6)))
    assert jnp.isnan(after.qpos[2]).all()
    assert not list(elsewhere.iterdir())


def test_a_non_finite_setpoint_gives_nan_in_its_own_environment(native_engine, mixed):
    state, surroundings, _ = mixed
    target = jnp.zeros((COUNT, 6)).at[3, 2].set(jnp.nan)
    after = np.asarray(native_engine.step(state, surroundings, target).qpos)
    assert np.isnan(after[3]).all() and np.isfinite(np.delete(after, 3, axis=0)).all()


def test_the_engine_of_a_cpu_is_native_unless_named():
    if jax.default_backend() == "cpu":
        assert select.resolve("auto") == "native"
    assert select.resolve("mjx") == "mjx"


def test_engines_are_made_by_name(scene):
    assert select.make("native", scene).name == "native"
    assert select.make("mjx", scene).name == "mjx"


@pytest.mark.skipif(importlib.util.find_spec("warp") is not None, reason="warp is installed")
def test_warp_is_refused_with_its_cure_where_it_is_not_installed():
    with pytest.raises(UserError, match=r"warp.*pip install"):
        select.resolve("warp")


@pytest.mark.skipif(importlib.util.find_spec("warp") is None, reason="warp is not installed")
def test_warp_agrees_with_native(scene, roll, native_roll, mixed):
    warp = mjx.make(scene, impl="warp")
    rolled = roll(warp._replace(advance=jax.jit(warp.advance)), *mixed)
    moved, turned = apart(native_roll.tips[-1], rolled.tips[-1])
    assert np.median(moved) < 5e-5 and np.median(turned) < 5e-4
    assert moved[SITUATION == FREE].max() < 5e-6
    assert moved.max() < 1e-3 and turned.max() < 1e-2
