"""What an observation and an action consist of; no simulator, no jax."""

import numpy as np

OBSERVATION = (
    ("joint_position", 7, "rad, relative to the start pose", 0.1),
    ("joint_velocity", 7, "rad/s", 0.5),
    ("tip_position", 3, "m, relative to the nominal socket", 0.03),
    ("tip_rotation", 3, "rad, rotation vector relative to the nominal socket", 0.1),
    ("tip_velocity", 3, "m/s", 0.1),
    ("tip_angular_velocity", 3, "rad/s", 0.5),
    ("setpoint_error", 3, "m, last setpoint minus tip position", 0.01),
)
"""Name, size, unit and scale of each part: an observation holds value / scale, clipped."""
OBS_SIZE = sum(size for _, size, _, _ in OBSERVATION)
SCALE = np.concatenate([np.full(size, scale, np.float32) for _, size, _, scale in OBSERVATION])
CLIP = 10.0


def _place(part: str) -> slice:
    before = [name for name, *_ in OBSERVATION].index(part)
    start = sum(size for _, size, _, _ in OBSERVATION[:before])
    return slice(start, start + OBSERVATION[before][1])


TIP_POSE = slice(_place("tip_position").start, _place("tip_rotation").stop)
"""Where an observation holds the tip's position and rotation."""
POSE_SCALE = SCALE[TIP_POSE]
ACTION_SIZE = 6
"""Displacement of the setpoint: three translations, three rotations, each in [-1, 1]."""
