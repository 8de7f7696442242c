"""Writes one policy of a run with its contract, and compares the file with the policy."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax.deploy import contract
from crsfd_jax.deploy.formats import FORMATS, mean_layers
from crsfd_jax.learn.networks import mode_action
from crsfd_jax.observation import CLIP, OBS_SIZE
from crsfd_jax.storage import trained
from crsfd_jax.storage.files import output, write_atomically, write_text

TOLERANCE = 1e-5
OBSERVATIONS = 1000
FILE, CONTRACT = "actor", "policy.json"

Policy = Callable[[np.ndarray], np.ndarray]
"""(obs [N, O]) -> action [N, A]."""


class Exported(NamedTuple):
    """What was written."""

    path: Path
    seed: int
    trained: Policy
    """The policy as it was trained."""
    written: Policy
    """The policy as its file says."""


def export(run: str, form: str, seed: str, out: str) -> Exported:
    """Writes the policy of a seed ("best" or a number) to a folder.

    Raises:
      UserError: no such run or seed, or the folder cannot be written.
    """
    source = trained.load(run)
    chosen = trained.choose(run, source.config, seed)
    actor = trained.actor(source, chosen)
    kind = FORMATS[form]
    folder = Path(out or Path(run) / "export" / form)
    path = folder / f"{FILE}{kind.suffix}"
    said = json.dumps(contract.describe(source, chosen, path.name), indent=2) + "\n"
    content = kind.write(mean_layers(actor))
    with output(folder):
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(path, lambda stream: stream.write(content))
        write_text(folder / CONTRACT, said)

    def act(obs: np.ndarray) -> np.ndarray:
        with jax.default_matmul_precision("highest"):
            return np.asarray(mode_action(source.nets.actor, actor, jnp.asarray(obs)))

    return Exported(path, chosen.seed, act, kind.read(path.read_bytes()))


def largest_difference(exported: Exported) -> float:
    """Largest difference of an action between policy and file; NaN if either is not a number."""
    random = np.random.default_rng(0)
    # Observations of all sizes up to the clip: large ones alone would saturate every action.
    size = 10 ** random.uniform(-2, 0, (OBSERVATIONS, 1))
    obs = CLIP * size * random.uniform(-1, 1, (OBSERVATIONS, OBS_SIZE))
    obs = obs.astype(np.float32)
    return float(np.abs(exported.trained(obs) - exported.written(obs)).max())
