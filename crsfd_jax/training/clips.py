"""A short film of the policy as it is at each evaluation, in the run folder: clips/STEPS.gif."""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from crsfd_jax.config import Config
from crsfd_jax.drawing import video
from crsfd_jax.physics.interface import CONTROL_DT
from crsfd_jax.progress import say
from crsfd_jax.storage.files import remove_leftovers
from crsfd_jax.training import devices
from crsfd_jax.viewer import film, live

EPISODES = 2
LONGEST = 100
"""Control steps of an episode that are shown."""

Recorder = Callable[[Any, int], None]
"""(actor parameters [S, ...], env_steps) -> None."""


def recorder(config: Config, place: Path) -> Recorder:
    """Writes a clip of the first seed's policy whenever it is called, from the same starts.

    It plays in the native engine, apart from training. A clip that cannot be made is told and is
    the last one tried: training goes on.
    """
    if not config.clips:
        return lambda actors, env_steps: None
    is_working = True
    arm = functools.cache(lambda: _arm(config))
    remove_leftovers(place)

    def record(actors: Any, env_steps: int) -> None:
        nonlocal is_working
        if not (is_working and devices.is_first()):
            return
        try:
            _write(arm()._replace(actors=actors), place / f"{env_steps}.gif")
        # Whatever a graphics driver raises, the run is worth more than its film.
        except Exception as error:
            is_working = False
            say(f"clips     none from here on: {type(error).__name__}: {error}")

    return record


def _arm(config: Config) -> live.Live:
    shown = min(config.mdp.horizon, LONGEST)
    return live.make(
        dataclasses.replace(config, mdp=dataclasses.replace(config.mdp, horizon=shown)), None
    )


def _write(loaded: live.Live, path: Path) -> None:
    path.parent.mkdir(exist_ok=True)
    wanted, key = live.task_of(loaded, None, None), jax.random.key(loaded.config.seed)
    frames, _ = film.record(loaded, wanted, EPISODES, key, film.SMALL)
    video.write(path, frames, CONTROL_DT / film.SMALL.per_step)
