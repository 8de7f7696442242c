"""`python -m crsfd_jax.evaluate RUN`: success of a trained policy, on any task."""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from crsfd_jax import cli
from crsfd_jax.config import Config
from crsfd_jax.options import validation
from crsfd_jax.options.field_types import Length, Shape
from crsfd_jax.options.limits import Interval
from crsfd_jax.options.randomisation import HELD_OUT, Randomisation
from crsfd_jax.storage import artefacts, files


@dataclass(frozen=True)
class Evaluate:
    """Plays fresh episodes with the deterministic policies of a run and reports success.

    Shape, shift and randomisation are the run's own where they are not given.
    """

    run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")]
    """Folder of the run."""
    shape: Shape | None = None
    """Peg and socket, as in training: one or several."""
    shift: Length | None = None
    """Side of the square of the socket's offset, such as 4mm."""
    held_out: bool = False
    """Draw what tells the arm from its model from other ranges than experiments/transfer.py."""
    randomisation: Randomisation = field(default_factory=Randomisation)
    episodes: Annotated[int, Interval(1, 1_000_000)] = 100
    """Episodes of each seed."""
    seed: Annotated[int, Interval(0, 2_000_000_000)] = 1_000_000
    """Seed of the episodes, apart from those of training and its evaluations."""
    engine: Literal["auto", "native", "mjx", "warp"] = "auto"
    """Physics engine; auto is mjx on an accelerator and native on a CPU."""
    csv: str = ""
    """New file for a table of trials and successes of each seed and shape; none if empty."""


def task_of(argv: list[str]) -> tuple[Evaluate, Config]:
    """What to do, and the run's options with those of the command line in their place.

    Raises:
      UserError: there is no such run, or an option cannot be used.
    """
    first = cli.parse(Evaluate, argv)
    own = artefacts.read_config(first.run)
    arm = HELD_OUT if first.held_out else own.randomisation
    default = Evaluate(run=first.run, shape=own.shape, shift=own.shift, randomisation=arm)
    given = cli.parse(Evaluate, argv, default)
    names = ("shape", "shift", "randomisation", "engine")
    task = dataclasses.replace(own, **{name: getattr(given, name) for name in names})
    validation.validate(task)
    if given.csv:
        files.reserve(given.csv, "--csv")
    return given, task


def run(argv: list[str]) -> int:
    """Evaluates as the command line says; see --help."""
    given, task = task_of(argv)
    from crsfd_jax import compile_cache, success

    compile_cache.enable()
    success.report(Path(given.run), task, given.episodes, given.seed, given.csv)
    return 0


if __name__ == "__main__":
    cli.main(run)
