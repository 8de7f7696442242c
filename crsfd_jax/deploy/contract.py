"""policy.json: all that a robot's control loop must know of a policy, besides its weights."""

import dataclasses
from typing import Any

import numpy as np

from crsfd_jax import task
from crsfd_jax.env import SETPOINT_HIGH, SETPOINT_LOW, SUCCESS_DEPTH, rest_posture
from crsfd_jax.observation import ACTION_SIZE, CLIP, OBS_SIZE, OBSERVATION
from crsfd_jax.options.randomisation import Randomisation
from crsfd_jax.physics.interface import CONTROL_DT
from crsfd_jax.scene.build import Scene
from crsfd_jax.scene.kinematics import chain
from crsfd_jax.storage import manifest
from crsfd_jax.storage.trained import Chosen, Trained


def describe(trained: Trained, chosen: Chosen, file: str) -> dict[str, Any]:
    """The contract of one seed's policy as plain JSON values, SI units.

    Args:
      file: name of the policy's file, in the same folder.
    """
    config = trained.config
    scene = task.scene_of(config)
    return {
        "file": file,
        "rate_hz": 1 / CONTROL_DT,
        "observation": _observation(scene),
        "action": {
            "input": "obs",
            "output": "action",
            "size": ACTION_SIZE,
            "parts": ["x", "y", "z", "rx", "ry", "rz"],
            "unit": "m along and rad about the axes of the nominal socket",
            "clip": 1.0,
            "scale": config.mdp.action_scale,
            "formula": "setpoint = clip(tip + clip(action, -1, 1) * scale, low, high)",
            "setpoint_low": list(SETPOINT_LOW),
            "setpoint_high": list(SETPOINT_HIGH),
        },
        "controller": _controller(scene),
        "frames": _frames(scene),
        "task": {
            "shape": config.shape,
            "shift": config.shift,
            "clearance": config.scene.clearance,
            "footprint": config.scene.footprint,
            "friction": config.scene.friction,
            "horizon": config.mdp.horizon,
            "success_depth": round(SUCCESS_DEPTH, 9),
        },
        "randomisation": _randomisation(config.randomisation),
        "trained": {
            "algorithm": config.algorithm,
            "seed": chosen.seed,
            "env_steps": chosen.env_steps,
            "success_rate": chosen.success,
            "episodes": chosen.episodes,
        },
        "versions": manifest.versions(),
    }


def _observation(scene: Scene) -> dict[str, Any]:
    parts = [
        {"name": name, "size": size, "unit": unit, "scale": scale}
        for name, size, unit, scale in OBSERVATION
    ]
    return {
        "size": OBS_SIZE,
        "parts": parts,
        "clip": CLIP,
        "formula": "obs = clip(value / scale, -clip, clip), parts in this order",
        "joint_rest": _numbers(np.asarray(rest_posture(chain(scene)))),
    }


def _controller(scene: Scene) -> dict[str, Any]:
    model = scene.model
    return {
        "formula": "force = clip(stiffness * (setpoint - tip) - damping * twist, -limit, limit)",
        "unit": "N/m, Ns/m and N for x, y, z; Nm/rad, Nms/rad and Nm for rx, ry, rz",
        "stiffness": _numbers(model.actuator_gainprm[:, 0]),
        "damping": _numbers(-model.actuator_biasprm[:, 2]),
        "limit": _numbers(model.actuator_forcerange[:, 1]),
        "rate_hz": 1 / model.opt.timestep,
    }


def _frames(scene: Scene) -> dict[str, Any]:
    peg = scene.model.body("peg")
    return {
        "base": "of the arm, z up",
        "nominal_socket": "middle of the mouth, axes parallel to the base's",
        "nominal_socket_in_base": _numbers(scene.nominal),
        "tip": "middle of the peg's end; its axes are the socket's when the hand points down",
        "tip_in_hand": _numbers(peg.pos),
        "tip_in_hand_wxyz": _numbers(peg.quat),
    }


def _randomisation(drawn: Randomisation) -> dict[str, Any]:
    return {
        "formula": "drawn anew for every episode of training; with factors 1 and zeros, nothing is",
        "unit": "friction, stiffness, damping: factors, low high; delay: share of episodes whose "
        "setpoints come one step late; socket_yaw, encoder_offset: rad, low high; "
        "position_noise: m, rotation_noise: rad, standard deviations of a reading",
        **dataclasses.asdict(drawn),
    }


def _numbers(array: np.ndarray) -> list[float]:
    # Rounded to what float32 holds, so that the file is read by people too.
    return [float(f"{value:.9g}") for value in array]
