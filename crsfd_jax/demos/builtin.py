"""The demonstrations that a run names: a file, or those that ship with the package."""

from pathlib import Path

from crsfd_jax.demos import dataset
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE

PATH = Path(__file__).parent / "shape0.npz"
"""40 episodes of shape 0, made by `python -m crsfd_jax.demos record`; see docs/method.md."""


def load(name: str) -> dataset.Demonstrations:
    """Reads a demonstration file by its path, or the shipped one by the name builtin.

    Raises:
      UserError: the file cannot be used.
    """
    return dataset.load(PATH if name == "builtin" else name, OBS_SIZE, ACTION_SIZE)
