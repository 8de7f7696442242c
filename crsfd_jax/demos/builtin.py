"""The demonstrations that a run names: a file, or those that ship with the package."""

import dataclasses
from pathlib import Path

from crsfd_jax.demos import dataset
from crsfd_jax.errors import UserError
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE

PATH = Path(__file__).parent / "shape0.npz"
"""40 episodes of shape 0, made by `python -m crsfd_jax.demos record`; see docs/method.md."""


def load(name: str, episodes: int = 0) -> dataset.Demonstrations:
    """Reads a demonstration file by its path, or the shipped one by the name builtin.

    Args:
      episodes: how many to use, the first of the file; all if 0.

    Raises:
      UserError: the file cannot be used, or has fewer episodes or no successful one among these.
    """
    if Path(name).suffix in (".hdf5", ".h5"):
        raise UserError(
            f"demo {name}: got an HDF5 file, allowed: .npz; make one with "
            f"python -m crsfd_jax.demos import {name} --out NAME.npz"
        )
    demos = dataset.load(PATH if name == "builtin" else name, OBS_SIZE, ACTION_SIZE)
    if not episodes:
        return demos
    present = len(demos.episode_length)
    if episodes > present:
        raise UserError(
            f"--demo-episodes: got {episodes}, allowed: at most the {present} of {name}; lower it"
        )
    first = _first(demos, episodes)
    dataset.check(first, OBS_SIZE, ACTION_SIZE, name)
    return first


def _first(demos: dataset.Demonstrations, episodes: int) -> dataset.Demonstrations:
    per_episode = ("episode_length", "start_qpos", "socket_offset")
    steps = int(demos.episode_length[:episodes].sum())
    kept = {
        field.name: getattr(demos, field.name)[: episodes if field.name in per_episode else steps]
        for field in dataclasses.fields(demos)
        if field.name != "provenance"
    }
    return dataclasses.replace(demos, **kept)
