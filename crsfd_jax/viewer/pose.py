"""Where the arm is drawn between two control steps, which come ten times a second."""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import mujoco
import numpy as np

from crsfd_jax.env import EnvState
from crsfd_jax.scene.build import Scene, place_socket


class Pose(NamedTuple):
    """What a picture of the arm shows."""

    qpos: np.ndarray
    """[7] rad."""
    qvel: np.ndarray
    """[7] rad/s."""
    socket_offset: np.ndarray
    """[2] m."""
    socket_yaw: np.ndarray | None
    """[] rad; None where it is 0."""
    friction: np.ndarray
    """[] sliding friction coefficient between peg and socket."""
    gains: np.ndarray | None
    """[2] factors of stiffness and damping; None where they are 1."""
    setpoint: np.ndarray
    """[6] m and rad."""


def between(before: EnvState, after: EnvState, setpoint: np.ndarray, count: int) -> Iterator[Pose]:
    """`count` poses on the way from one state of an arm to the next, the last one there."""
    ends = [np.asarray(state.physics.qpos)[0] for state in (before, after)]
    speeds = [np.asarray(state.physics.qvel)[0] for state in (before, after)]
    around = jax.tree.map(lambda leaf: np.asarray(leaf)[0], after.around)
    for share in np.linspace(0, 1, count + 1)[1:]:
        qpos, qvel = ((1 - share) * first + share * last for first, last in (ends, speeds))
        place = around.socket_offset, around.socket_yaw
        yield Pose(qpos, qvel, *place, around.friction, around.gains, setpoint)


def still(state: EnvState) -> Pose:
    """The arm at rest where a state has it, pulled nowhere."""
    return next(between(state, state, np.asarray(state.tip)[0], 1))


def put(model: mujoco.MjModel, data: mujoco.MjData, pose: Pose, scene: Scene) -> None:
    """Brings a simulation of `model_of` the scene to a pose, contact forces included."""
    data.qpos[:], data.qvel[:], data.ctrl[:] = pose.qpos, pose.qvel, pose.setpoint
    model.geom_friction[scene.look_parts, 0] = pose.friction
    gains = np.ones(2) if pose.gains is None else pose.gains
    model.actuator_gainprm[:, 0] = scene.look.actuator_gainprm[:, 0] * gains[0]
    model.actuator_biasprm[:, 1:3] = scene.look.actuator_biasprm[:, 1:3] * gains
    place_socket(data, scene, pose.socket_offset, pose.socket_yaw)
    mujoco.mj_forward(model, data)
