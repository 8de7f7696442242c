"""Runs an exported policy on a robot, with numpy alone; docs/real_arm.md explains it.

robot.read() -> joint angles [7], joint velocities [7], tip pose [4, 4], tip twist [6]
robot.hold(pose [4, 4]): makes a tip pose the setpoint of the impedance controller, for 0.1 s
"""

import json
from pathlib import Path

import numpy as np


def load(folder):
    """The contract and the layers that `python -m crsfd_jax.export RUN --format npz` wrote."""
    contract = json.loads((Path(folder) / "policy.json").read_text())
    with np.load(Path(folder) / contract["file"], allow_pickle=False) as arrays:
        count = len(arrays.files) // 2
        return contract, [(arrays[f"weight{i}"], arrays[f"bias{i}"]) for i in range(count)]


def act(layers, obs):
    for weight, bias in layers[:-1]:
        obs = np.maximum(obs @ weight + bias, 0)
    return np.tanh(obs @ layers[-1][0] + layers[-1][1])


def rotation_vector(m):
    skew = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    length = max(np.linalg.norm(skew), 1e-9)
    return skew * np.arctan2(length, np.trace(m) - 1) / length


def pose_matrix(position, vector):
    angle = max(np.linalg.norm(vector), 1e-9)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return np.vstack([np.column_stack([rotation, position]), [0, 0, 0, 1]])


def insert(robot, contract, layers):
    """Plays one episode; True if the tip came to the bottom of the hole."""
    sees, does, task = contract["observation"], contract["action"], contract["task"]
    origin = np.array(contract["frames"]["nominal_socket_in_base"])
    scale = np.concatenate([[part["scale"]] * part["size"] for part in sees["parts"]])
    low, high, step = (np.array(does[k]) for k in ("setpoint_low", "setpoint_high", "scale"))
    setpoint = None
    for left in range(task["horizon"], -1, -1):
        q, dq, pose, twist = robot.read()
        tip = np.concatenate([pose[:3, 3] - origin, rotation_vector(pose[:3, :3])])
        state = np.concatenate([q - sees["joint_rest"], dq, tip, twist])
        outside = np.abs(tip - np.clip(tip, low, high)) > [0.01] * 3 + [0.1] * 3
        if outside.any() or not np.isfinite(state).all():
            raise RuntimeError(f"the tip has left the workspace, or is not known: {state}")
        if not left or tip[2] < -task["success_depth"]:
            return bool(tip[2] < -task["success_depth"])
        error = np.zeros(3) if setpoint is None else setpoint[:3] - tip[:3]
        obs = np.clip(np.concatenate([state, error]) / scale, -sees["clip"], sees["clip"])
        setpoint = np.clip(tip + np.clip(act(layers, obs), -1, 1) * step, low, high)
        robot.hold(pose_matrix(setpoint[:3] + origin, setpoint[3:]))
