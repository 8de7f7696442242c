"""Episodes of a trained policy as frames, drawn off screen."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import mujoco
import numpy as np

from crsfd_jax import compile_cache
from crsfd_jax.drawing import picture, video
from crsfd_jax.physics.interface import CONTROL_DT
from crsfd_jax.scene.build import model_of
from crsfd_jax.storage.files import output
from crsfd_jax.viewer import live, pose

CAMERA = "close"


class Look(NamedTuple):
    """How large and how smooth a film is."""

    width: int
    height: int
    per_step: int
    """Pictures in a control step."""
    rest: int
    """Frames for which the end of an episode stays in view."""
    shadow: int
    """Side of the shadow's map in pixels; without a graphics card it takes most of the time."""


LARGE = Look(640, 480, 2, 10, 4096)
SMALL = Look(240, 180, 1, 5, 1024)


def make(run: str, shape: str | None, shift: float | None, episodes: int, path: Path) -> str:
    """Films fresh episodes of a run's first seed; says what was filmed.

    Raises:
      UserError: the run or the file cannot be used, or no OpenGL works.
    """
    video.check_name(path)
    compile_cache.enable()
    loaded = live.load(run)
    wanted = live.task_of(loaded, shape, shift)
    key = jax.random.key(loaded.config.seed)
    frames, inserted = record(loaded, wanted, episodes, key, LARGE)
    with output(path, "--video"):
        video.write(path, frames, CONTROL_DT / LARGE.per_step)
    return f"wrote {path}: {inserted} of {episodes} episodes inserted"


def record(
    loaded: live.Live, wanted: live.Task, episodes: int, key: jax.Array, look: Look
) -> tuple[list[np.ndarray], int]:
    """Plays the policy of the first seed.

    Returns:
      Frames, uint8 [height, width, 3] each, and how many episodes ended inserted.

    Raises:
      UserError: no OpenGL works on this machine.
    """
    model = model_of(loaded.scene, loaded.scene.shapes.index(wanted.shape))
    model.vis.quality.shadowsize = look.shadow
    data, frames, inserted = mujoco.MjData(model), [], 0
    with picture.camera_of(model, CAMERA, look.width, look.height) as draw:
        for episode_key in jax.random.split(key, episodes):
            for taken, poses in _episode(loaded, wanted, episode_key, look.per_step):
                for at in poses:
                    pose.put(model, data, at, loaded.scene)
                    frames.append(draw(data))
                inserted += bool(taken.outcome.terminated[0])
            frames += frames[-1:] * look.rest
    return frames, inserted


def _episode(
    loaded: live.Live, wanted: live.Task, key: jax.Array, per_step: int
) -> Iterator[tuple[live.Step, Iterator[pose.Pose]]]:
    """The steps of an episode until it is over or breaks down, and the way of the arm in each."""
    state = loaded.reset(wanted, key)
    for _ in range(loaded.config.mdp.horizon):
        taken = loaded.advance(state, loaded.act(loaded.actors, 0, state))
        if not taken.outcome.finite[0]:
            return
        yield taken, pose.between(state, taken.state, taken.setpoint, per_step)
        if taken.outcome.terminated[0]:
            return
        state = taken.state
