"""Is the contact sound? Insertion where parts fit, walls elsewhere, however hard the push."""

import dataclasses
import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from crsfd_jax import config, env
from crsfd_jax.physics import native
from crsfd_jax.physics.interface import CONTROL_DT, Surroundings
from crsfd_jax.scene import build, digits, kinematics

MDP = config.Mdp()
SHAPES = range(len(config.SHAPES))
TOLERANCE = 0.5e-3
"""m, deepest that a corner of one part may be found inside the other after a control step."""
OUTLINE_TOLERANCE = 1e-3
"""m, the same for the sharp edges: a sphere of 1 mm lets its corner in by (3^0.5 - 1) mm before."""


def tip_of(links, qpos):
    position, rotation, _ = kinematics.tip_pose(links, qpos)
    return jnp.concatenate([position, kinematics.rotation_vector(rotation)], axis=-1)


def scene_with(clearance):
    return build.build(dataclasses.replace(config.Scene(), clearance=clearance))


# Straight down


def lowered(at_rest, scene, offset, yaw=0.0):
    """bool [shapes]: inserted within 5 s by lowering the peg without any search."""
    links, engine = kinematics.chain(scene), native.make(scene)
    count = len(SHAPES)
    turn = np.array([0.0, 0.0, yaw], np.float32)
    around = Surroundings(
        shape=jnp.arange(count, dtype=jnp.int32),
        socket_offset=jnp.tile(jnp.asarray(offset, jnp.float32), (count, 1)),
        friction=jnp.ones(count),
    )

    def step(state, _):
        down = tip_of(links, state.qpos)[:, 2] - MDP.translation_scale
        target = jnp.zeros((count, 6)).at[:, 2].set(down).at[:, 3:].set(turn)
        state = engine.step(state, around, target)
        return state, env.inserted(tip_of(links, state.qpos), around)

    start = at_rest(np.tile([0.0, 0.0, 0.02], (count, 1)), turn)
    return np.asarray(jax.jit(lambda s: jax.lax.scan(step, s, length=50)[1])(start)).any(axis=0)


def test_every_shape_is_inserted_straight_down_at_zero_offset(at_rest, scene):
    assert lowered(at_rest, scene, (0, 0)).all()


@pytest.mark.parametrize("offset", [(3e-3, 0), (0, -3e-3), (-2.2e-3, 2.2e-3)])
def test_no_shape_is_inserted_three_millimetres_beside_its_socket(at_rest, scene, offset):
    assert not lowered(at_rest, scene, offset).any()


@pytest.mark.parametrize("degrees", [20, -20])
def test_no_shape_is_inserted_when_turned_by_twenty_degrees(at_rest, scene, degrees):
    assert not lowered(at_rest, scene, (0, 0), np.deg2rad(degrees)).any()


def test_a_peg_one_millimetre_wider_than_its_hole_is_not_inserted(at_rest):
    assert not lowered(at_rest, scene_with(-1e-3), (0, 0)).any()


# Penetration, from the contacts of every physics step


class Push(NamedTuple):
    """Deepest penetration of a push, m."""

    impact: float
    """In any substep."""
    steady: float
    """Once pressing no longer moves the tip; 0 if it never comes to rest."""
    warnings: int


def tip_in(data, scene):
    """[6] m and rad, as `tip_of`."""
    quaternion, vector = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quaternion, data.site_xmat[scene.tip_site])
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return np.concatenate([data.site_xpos[scene.tip_site] - scene.nominal, vector])


def push(scene, model, qpos, action, steps=30) -> Push:
    """Holds an action against whatever is in its way, with MuJoCo's own stepping."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    scale = np.repeat([MDP.translation_scale, MDP.rotation_scale], 3)
    impact = steady = resting = 0.0
    mujoco.mj_kinematics(model, data)
    for _ in range(steps):
        before, deepest = tip_in(data, scene), 0.0
        data.ctrl[:] = np.clip(before + action * scale, env.SETPOINT_LOW, env.SETPOINT_HIGH)
        for _ in range(round(CONTROL_DT / model.opt.timestep)):
            mujoco.mj_step(model, data)
            deepest = max(deepest, -data.contact.dist.min(initial=0.0))
        mujoco.mj_kinematics(model, data)
        moved = np.abs(tip_in(data, scene) - before)
        resting = resting + 1 if moved[:3].max() < 2e-5 and moved[3:].max() < 1e-3 else 0
        impact = max(impact, deepest)
        steady = max(steady, deepest) if resting >= 2 else steady
    return Push(impact, steady, int(data.warning.number.sum()))


def starts(rng, count):
    """[3 * count, 3] m: in free motion, just above the mouth, and inside the hole."""
    free = rng.uniform([-0.03, -0.03, 0.01], [0.03, 0.03, 0.04], (count, 3))
    mouth = rng.uniform([-0.01, -0.01, 0.003], [0.01, 0.01, 0.003], (count, 3))
    inside = rng.uniform([0, 0, -0.028], [0, 0, -0.003], (count, 3))
    return np.concatenate([free, mouth, inside])


TRANSLATIONS = np.array([a for a in itertools.product((-1, 0, 1), repeat=3) if any(a)])


def pushes(scene, at_rest, shape, actions, seed):
    """Every action from every kind of start."""
    qpos = np.asarray(at_rest(starts(np.random.default_rng(seed), len(actions))).qpos)
    model = build.model_of(scene, shape)
    every = np.tile(actions, (3, 1))
    return [push(scene, model, q, a) for q, a in zip(qpos, every, strict=True)]


@pytest.mark.parametrize("shape", SHAPES)
def test_pushing_in_any_direction_stays_within_the_limits_of_penetration(scene, at_rest, shape):
    actions = np.pad(TRANSLATIONS, ((0, 0), (0, 3)))
    done = pushes(scene, at_rest, shape, actions, seed=shape)
    assert max(p.impact for p in done) < 0.3e-3
    assert max(p.steady for p in done) < 0.1e-3
    assert sum(p.steady > 0 for p in done) > 20, "hardly anything was pressed against"
    assert not any(p.warnings for p in done)


@pytest.mark.parametrize("shape", SHAPES)
def test_pushing_and_turning_on_six_axes_at_once_stays_within_them(scene, at_rest, shape):
    actions = np.random.default_rng(shape).choice([-1.0, 1.0], (20, 6))
    done = pushes(scene, at_rest, shape, actions, seed=10 + shape)
    assert max(p.impact for p in done) < 0.3e-3
    assert max(p.steady for p in done) < 0.1e-3
    assert not any(p.warnings for p in done)


# Tunnelling, from the geometry of the parts


def distance(points, boxes):
    """[...] m from points [..., 3] to the nearest of boxes [K, 6]; negative inside."""
    beyond = np.abs(points[..., None, :] - boxes[:, :3]) - boxes[:, 3:]
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=-1)
    return (outside + np.minimum(beyond.max(axis=-1), 0)).min(axis=-1)


def outline(solids):
    """[P, 3] m, points half a millimetre apart on the lower edges of a peg."""
    axis = np.arange(-0.0205, 0.0205, 0.5e-3)
    points = np.stack([*np.meshgrid(axis, axis, indexing="ij"), np.zeros((len(axis),) * 2)], -1)
    points = points.reshape(-1, 3)
    above = points + np.array([[0, 0, 1e-3]])
    edge = distance(above, solids.peg_boxes)
    return points[(edge < 0) & (edge > -0.7e-3)]


class Depth(NamedTuple):
    """Deepest intrusion over many states, m."""

    corner: float
    """Of the peg's lower corners into the socket."""
    rim: float
    """Of the socket's rim into the peg."""
    outline: float
    """Of any point of the peg's lower edges into the socket, once the peg is in the hole."""


def depth(solids, position, rotation) -> Depth:
    """Intrusion of pegs with tips at positions [M, 3] (m, socket frame), rotations [M, 3, 3]."""

    def placed(points):
        return position[:, None] + np.einsum("mij,pj->mpi", rotation, points)

    rims = np.einsum("mji,mpj->mpi", rotation, solids.socket_rims - position[:, None])
    inside = position[:, 2] < -2e-3
    edges = distance(placed(outline(solids))[inside], solids.socket_boxes)
    radius = digits.CORNER_RADIUS
    return Depth(
        corner=radius - distance(placed(solids.peg_corners), solids.socket_boxes).min(),
        rim=radius - distance(rims, solids.peg_boxes).min(),
        outline=-edges.min(initial=np.inf),
    )


EPISODES, STEPS, HELD = 400, 50, 5


def hard_pushes(seed, fits=True):
    """Starts [N, 3], offsets [N, 2], frictions [N] and actions [T, N, 6] of hard-pushing episodes.

    Actions of magnitude 1 are held for half a second; half of them press down.
    """
    rng = np.random.default_rng(seed)
    offset = rng.uniform(-4e-3, 4e-3, (EPISODES, 2))
    start = starts(rng, EPISODES).reshape(3, EPISODES, 3)
    start = start[np.arange(EPISODES) // len(SHAPES) % (3 if fits else 2), np.arange(EPISODES)]
    start[:, :2] = np.clip(start[:, :2] + offset, -0.04, 0.04)
    action = rng.choice([-1.0, 0.0, 1.0], (STEPS // HELD, EPISODES, 6))
    action[..., 2] = np.where(rng.random(action.shape[:2]) < 0.5, -1.0, action[..., 2])
    return start, offset, rng.uniform(0.3, 1.2, EPISODES), np.repeat(action, HELD, axis=0)


@pytest.fixture(scope="module")
def sweep(at_rest, around):
    """(scene, seed) -> shapes [N], places from the socket [T, N, 3] m, rotations [T, N, 3, 3]."""
    compiled = {}

    def roll_of(scene):
        links, engine = kinematics.chain(scene), native.make(scene)

        def step(carry, action):
            state, around = carry
            state = engine.step(state, around, env.setpoint(MDP, tip_of(links, state.qpos), action))
            return (state, around), kinematics.tip_pose(links, state.qpos)[:2]

        return jax.jit(lambda *carry_and_actions: jax.lax.scan(step, *carry_and_actions)[1])

    def run(scene, seed, fits=True):
        roll = compiled.setdefault(id(scene), roll_of(scene))
        start, offset, friction, action = hard_pushes(seed, fits)
        shape = np.arange(EPISODES) % len(SHAPES)
        carry = (at_rest(start), around(shape, offset, friction))
        position, rotation = map(np.asarray, roll(carry, jnp.asarray(action, jnp.float32)))
        return shape, position - np.pad(offset, ((0, 0), (0, 1))), rotation

    return run


def check_hard_pushing(sweep, scene, clearance, rounds):
    """Asserts soundness after every control step; prints what was found."""
    found, steps = [], 0
    for seed in range(rounds):
        shape, position, rotation = sweep(scene, seed)
        assert np.isfinite(position).all() and np.isfinite(rotation).all()
        assert position[..., 2].min() > -digits.HOLE_DEPTH - TOLERANCE, "through the floor"
        assert np.abs(position[..., :2]).max() < digits.BLOCK_HALF_WIDTH, "beside the block"
        for i in SHAPES:
            solids = digits.solids(config.SHAPES[i], 0.04, clearance)
            at = position[:, shape == i].reshape(-1, 3)
            found.append(depth(solids, at, rotation[:, shape == i].reshape(-1, 3, 3)))
        steps += position[..., 0].size
    worst = Depth(*np.max(found, axis=0))
    print(f"{steps} control steps, deepest in mm: {Depth(*(1e3 * np.array(worst)))}")
    assert max(worst.corner, worst.rim) < TOLERANCE
    assert 0 < worst.outline < OUTLINE_TOLERANCE


@pytest.fixture
def warnings():
    """What MuJoCo warns of, which an engine silences where nobody listens."""
    heard, before = [], mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(heard.append)
    yield heard
    mujoco.set_mju_user_warning(before)


def test_hard_pushing_never_drives_one_part_into_the_other(sweep, scene, warnings):
    check_hard_pushing(sweep, scene, 1e-3, rounds=1)
    assert warnings == []


@pytest.mark.slow
def test_two_hundred_thousand_hard_pushes_stay_sound(sweep, scene, warnings, capfd):
    with capfd.disabled():
        check_hard_pushing(sweep, scene, 1e-3, rounds=10)
    assert warnings == []


def test_no_hard_pushing_inserts_a_peg_that_is_too_wide(sweep):
    _, position, _ = sweep(scene_with(-1e-3), 0, fits=False)
    assert position[..., 2].min() > -digits.CORNER_RADIUS
