"""What decides held-out trials: how far from its expected place a hole seems to be.

Hypothesis: an arm with badly calibrated joints seems to meet a hole that is further away, and a
policy finds holes as far away as it has met in training; friction narrows that.

    python experiments/studies/reach.py runs/transfer/crsfd-shape1-shift2mm-randomised-seed0x5

For each run: success in 1,000 episodes of each seed under the held-out randomisation, by friction
and by the larger of the distances along x and y at which the arm perceives the hole.
"""

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import search
import tyro

from crsfd_jax import cli, compile_cache, config
from crsfd_jax.env import rest_posture
from crsfd_jax.options.randomisation import HELD_OUT
from crsfd_jax.physics.interface import Surroundings
from crsfd_jax.scene.build import build
from crsfd_jax.scene.kinematics import chain, tip_pose
from crsfd_jax.storage import trained

EDGES = np.array([0.0, 0.5, 1.0, 1.5, np.inf]) * 1e-3
"""m."""


def perceived(around: Surroundings) -> np.ndarray:
    """[S, K, 2] m, where the hole is for an arm that believes its joints, in x and y."""
    links = chain(build(config.Scene()))
    rest = rest_posture(links)
    believed = tip_pose(links, rest + np.asarray(around.encoder_offset))[0]
    error = np.asarray(believed - tip_pose(links, rest)[0])
    return np.asarray(around.socket_offset) + error[..., :2]


@dataclass(frozen=True)
class Reach:
    """What decides held-out trials: how far from its expected place a hole seems to be."""

    run: tyro.conf.Positional[Path]
    """Folder of a run."""
    others: tyro.conf.Positional[tuple[Path, ...]] = ()
    """More of them."""


def main(argv: list[str]) -> None:
    """Prints a line for each run and friction."""
    options = cli.parse(Reach, argv)
    compile_cache.enable()
    for run in (options.run, *options.others):
        around, success, *_ = search.play(trained.load(run), HELD_OUT)
        distance = np.abs(perceived(around)).max(axis=-1)
        print(f"{run.name}: {success.mean():.3f}; by distance, its edges in mm {EDGES[:-1] * 1e3}")
        for words, chosen in (("low", around.friction < 1), ("high", around.friction > 1)):
            cells = [
                success[chosen & (distance >= low) & (distance < high)]
                for low, high in itertools.pairwise(EDGES)
            ]
            shown = "  ".join(f"{cell.mean():.3f} of {cell.size}" for cell in cells)
            print(f"  friction {words:4s}  {shown}")


if __name__ == "__main__":
    cli.main(main)
