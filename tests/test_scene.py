"""The compiled scene against the arm's data sheet, written out here a second time."""

import dataclasses

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from crsfd_jax import config
from crsfd_jax.scene import build, digits

DH = (
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -np.pi / 2),
    (0.0, 0.316, np.pi / 2),
    (0.0825, 0.0, np.pi / 2),
    (-0.0825, 0.384, -np.pi / 2),
    (0.0, 0.0, np.pi / 2),
    (0.088, 0.0, np.pi / 2),
)
"""Craig's a (m), d (m), alpha (rad) of the Panda, Franka Control Interface documentation."""
FLANGE, GRASP, HAND_YAW = 0.107, 0.1034, -np.pi / 4
LIMITS = ((-2.8973, 2.8973), (-1.7628, 1.7628), (-2.8973, 2.8973), (-3.0718, -0.0698))
LIMITS = (*LIMITS, (-2.8973, 2.8973), (-0.0175, 3.7525), (-2.8973, 2.8973))
LINK_MASSES = (0.629769, 4.970684, 0.646926, 3.228604, 3.587895, 1.225946, 1.666555, 0.735522)
HAND_MASS, PEG_MASS = 0.73, 0.1


def craig(a, d, alpha, theta):
    """[4, 4] transform of a link, modified Denavit-Hartenberg."""
    st, ct, sa, ca = np.sin(theta), np.cos(theta), np.sin(alpha), np.cos(alpha)
    return np.array(
        [
            [ct, -st, 0, a],
            [st * ca, ct * ca, -sa, -d * sa],
            [st * sa, ct * sa, ca, d * ca],
            [0, 0, 0, 1],
        ]
    )


def link_frames(qpos):
    """[8, 4, 4] frames of links 1 to 7 and of the flange in the base."""
    frames = [np.eye(4)]
    for (a, d, alpha), theta in zip((*DH, (0.0, FLANGE, 0.0)), (*qpos, 0.0), strict=True):
        frames.append(frames[-1] @ craig(a, d, alpha, theta))
    return np.stack(frames[1:])


def posed(model, qpos):
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data


def random_joints(count, seed=0):
    low, high = np.array(LIMITS).T
    return np.random.default_rng(seed).uniform(low, high, (count, 7))


def test_the_oracle_itself_gives_the_published_pose():
    qpos = (0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4)
    grasp = link_frames(qpos)[-1] @ craig(0.0, GRASP, 0.0, HAND_YAW)
    np.testing.assert_allclose(grasp[:3, 3], [0.3069, 0, 0.4869], atol=5e-5)
    np.testing.assert_allclose(grasp[:3, :3], np.diag([1, -1, -1]), atol=1e-9)


def test_every_link_frame_follows_the_denavit_hartenberg_table(scene):
    for qpos in random_joints(20):
        data, frames = posed(scene.model, qpos), link_frames(qpos)
        for i, frame in enumerate(frames[:7], start=1):
            body = data.body(f"link{i}")
            np.testing.assert_allclose(body.xpos, frame[:3, 3], atol=1e-6)
            np.testing.assert_allclose(body.xmat.reshape(3, 3), frame[:3, :3], atol=1e-6)


def test_hand_and_peg_hang_on_the_flange(scene):
    for qpos in random_joints(20, seed=1):
        data, flange = posed(scene.model, qpos), link_frames(qpos)[-1]
        np.testing.assert_allclose(data.body("hand").xpos, flange[:3, 3], atol=1e-6)
        tip = GRASP + digits.PEG_LENGTH - digits.GRIP_LENGTH
        end = flange @ craig(0.0, tip, 0.0, HAND_YAW) @ np.diag([1, -1, -1, 1])
        np.testing.assert_allclose(data.site("tip").xpos, end[:3, 3], atol=1e-6)
        np.testing.assert_allclose(data.site("tip").xmat.reshape(3, 3), end[:3, :3], atol=1e-6)


def test_joint_limits_and_torques_are_those_of_the_panda(scene):
    names = [scene.model.joint(i).name for i in range(7)]
    assert names == [f"joint{i}" for i in range(1, 8)]
    np.testing.assert_array_equal(scene.model.jnt_range, LIMITS)
    torque = np.array([87, 87, 87, 87, 12, 12, 12])[:, None] * [-1, 1]
    np.testing.assert_array_equal(scene.model.jnt_actfrcrange, torque)
    assert scene.model.jnt_limited.all() and scene.model.jnt_actfrclimited.all()


def test_masses_are_those_of_the_identified_arm(scene):
    names = [f"link{i}" for i in range(8)]
    masses = [scene.model.body(name).mass[0] for name in names]
    np.testing.assert_allclose(masses, LINK_MASSES)
    total = sum(LINK_MASSES) + HAND_MASS + PEG_MASS
    np.testing.assert_allclose(scene.model.body_mass.sum(), total)
    np.testing.assert_allclose(total, 17.521901)


def test_an_arm_at_its_setpoint_stays_there(at_rest, around, native_engine):
    tip = np.array([[0, 0, 0.04], [0.03, -0.03, 0.07], [-0.03, 0.02, 0.01]], np.float32)
    state, surroundings = at_rest(tip), around([0, 2, 4])
    start = state.qpos
    setpoint = jnp.concatenate([jnp.asarray(tip), jnp.zeros((3, 3))], axis=1)
    for _ in range(20):
        state = native_engine.step(state, surroundings, setpoint)
    np.testing.assert_allclose(state.qpos, start, atol=1e-5)
    assert float(jnp.abs(state.qvel).max()) < 1e-5


def test_only_the_controller_holds_the_arm(scene, at_rest):
    """Without compensation the arm would fall: gravity is there, and taken up link by link."""
    assert scene.model.opt.gravity[2] == -9.81
    data = posed(scene.model, np.asarray(at_rest([[0, 0, 0.04]]).qpos[0]))
    assert np.abs(data.qfrc_bias).max() > 10
    np.testing.assert_allclose(data.qfrc_gravcomp, data.qfrc_bias, atol=1e-9)


def test_the_controller_is_an_impedance_clipped_at_the_pull_of_a_full_action(scene, at_rest):
    model, mdp = scene.model, config.Mdp()
    stiffness, damping = model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]
    limit = stiffness * np.repeat([mdp.translation_scale, mdp.rotation_scale], 3)
    np.testing.assert_allclose(limit, [10, 10, 10, 1, 1, 1])
    rng = np.random.default_rng(0)
    for _ in range(20):
        pose = rng.uniform(-0.02, 0.02, 6)
        pose[2] += 0.04
        data = posed(model, np.asarray(at_rest(pose[None, :3], pose[None, 3:]).qpos[0]))
        data.qvel[:] = rng.normal(size=7) * 0.02
        data.ctrl[:] = pose + rng.uniform(-0.03, 0.03, 6)
        mujoco.mj_forward(model, data)
        jacobian = np.zeros((6, 7))
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], scene.tip_site)
        force = stiffness * (data.ctrl - pose) - damping * (jacobian @ data.qvel)
        expected = np.clip(force, -limit, limit)
        np.testing.assert_allclose(data.actuator_force, expected, atol=0.02)
        np.testing.assert_allclose(data.qfrc_actuator, jacobian.T @ data.actuator_force, atol=0.02)


@pytest.mark.parametrize("shape", config.SHAPES)
def test_a_row_of_the_tables_is_the_model_compiled_for_that_shape_alone(scene, shape):
    alone = build.build(config.Scene(), (shape,))
    row = scene.shapes.index(shape)
    names = {alone.model.geom(i).name for i in alone.part_geoms}
    for geom in scene.part_geoms:
        name = scene.model.geom(geom).name
        if name in names:
            mine = alone.model.geom(name).id
            for field, table in scene.geometry.items():
                np.testing.assert_array_equal(table[row, geom], alone.geometry[field][0, mine])
        else:
            assert scene.geometry["geom_size"][row, geom].max() <= 1e-4, "surplus, yet not a point"
    assert len(names) == sum(len(getattr(digits.solids(shape, 0.04, 1e-3), f)) for f in KINDS)


KINDS = ("peg_boxes", "peg_corners", "socket_boxes", "socket_rims")


@pytest.mark.parametrize("shape", range(5))
def test_surplus_primitives_touch_nothing_at_the_bottom_of_the_hole(scene, at_rest, shape):
    model = build.model_of(scene, shape)
    for height in (-digits.HOLE_DEPTH, 0.0, 0.02):
        data = posed(model, np.asarray(at_rest([[0, 0, height + 1e-4]]).qpos[0]))
        assert data.ncon == 0


@pytest.mark.parametrize("shape", range(5))
def test_an_upright_peg_at_the_mouth_is_turned_like_its_socket(scene, at_rest, shape):
    data = posed(build.model_of(scene, shape), np.asarray(at_rest([[0, 0, 0.01]]).qpos[0]))
    boxes = digits.solids(scene.shapes[shape], 0.04, 1e-3).peg_boxes
    for i, box in enumerate(boxes):
        geom = data.geom(f"peg_box{i}")
        expected = scene.nominal + box[:3] + [0, 0, 0.01]
        np.testing.assert_allclose(geom.xpos, expected, atol=2e-5)
        np.testing.assert_allclose(geom.xmat.reshape(3, 3), np.eye(3), atol=2e-4)


def test_a_change_between_shapes_outside_the_tables_is_refused(scene):
    other = scene.model.__copy__()
    other.body_mass[3] += 0.1
    with pytest.raises(ValueError, match="body_mass differs between shapes"):
        build._check_equal([scene.model, other])


def test_the_first_shape_must_enclose_the_others():
    with pytest.raises(ValueError, match="must enclose"):
        build.build(dataclasses.replace(config.Scene(), clearance=1e-3), ("1", "0"))


def test_the_socket_moves_and_nothing_else_does(scene):
    assert scene.model.nmocap == 1
    assert scene.model.body("socket").mocapid[0] == 0
    np.testing.assert_array_equal(scene.model.body("socket").pos, scene.nominal)
    assert scene.model.nq == scene.model.nv == 7
    data = mujoco.MjData(scene.model)
    build.place_socket(data, scene, np.array([1e-3, -2e-3]), np.float32(0.3))
    mujoco.mj_forward(scene.model, data)
    socket = data.body("socket")
    np.testing.assert_allclose(socket.xpos - scene.nominal, [1e-3, -2e-3, 0], atol=1e-9)
    turn = [[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]]
    np.testing.assert_allclose(socket.xmat.reshape(3, 3), turn, atol=1e-6)
