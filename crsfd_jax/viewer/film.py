"""Episodes of a trained policy as frames, drawn off screen."""

from pathlib import Path

import jax
import mujoco
import numpy as np

from crsfd_jax import compile_cache
from crsfd_jax.errors import UserError
from crsfd_jax.physics.interface import CONTROL_DT
from crsfd_jax.report import picture, video
from crsfd_jax.scene.build import model_of
from crsfd_jax.viewer import live, pose

WIDTH, HEIGHT = 640, 480
CAMERA = "close"
FRAMES = 2
"""Pictures in a control step."""
_REST = 10
"""Frames for which the end of an episode stays in view."""


def make(run: str, shape: str | None, shift: float | None, episodes: int, path: Path) -> str:
    """Films fresh episodes of a run's first seed; says what was filmed.

    Raises:
      UserError: the run or the file cannot be used, or no OpenGL works.
    """
    video.check_name(path)
    compile_cache.enable()
    loaded = live.load(run)
    wanted = live.task_of(loaded, shape, shift)
    frames, inserted = record(loaded, wanted, episodes, jax.random.key(loaded.config.seed))
    try:
        video.write(path, frames, CONTROL_DT / FRAMES)
    except OSError as error:
        raise UserError(f"--video: {path} cannot be written: {error.strerror}") from error
    return f"wrote {path}: {inserted} of {episodes} episodes inserted"


def record(
    loaded: live.Live, wanted: live.Task, episodes: int, key: jax.Array
) -> tuple[list[np.ndarray], int]:
    """Frames, uint8 [HEIGHT, WIDTH, 3] each, and how many episodes ended inserted."""
    model = model_of(loaded.scene, loaded.scene.shapes.index(wanted.shape), wanted.friction)
    data, frames, inserted = mujoco.MjData(model), [], 0
    with picture.camera_of(model, CAMERA, WIDTH, HEIGHT) as draw:
        for episode_key in jax.random.split(key, episodes):
            state, is_inserted = loaded.reset(wanted, episode_key), False
            for _ in range(loaded.config.mdp.horizon):
                taken = loaded.advance(state, loaded.act(0, state))
                for at in pose.between(state, taken.state, taken.setpoint, FRAMES):
                    pose.put(model, data, at, loaded.scene.nominal)
                    frames.append(draw(data))
                state, is_inserted = taken.state, bool(taken.outcome.terminated[0])
                if is_inserted:
                    break
            inserted += is_inserted
            frames += frames[-1:] * _REST
    return frames, inserted
