"""What is played with trained policies: the options of `python -m crsfd_jax.evaluate`."""

import dataclasses
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import tyro

from crsfd_jax import cli
from crsfd_jax.config import Config
from crsfd_jax.options.field_types import Engine, Length, Seed, Shape
from crsfd_jax.options.limits import Interval
from crsfd_jax.options.names import by_full_name, show
from crsfd_jax.options.randomisation import HELD_OUT, Randomisation

_NOT_PLAYED = ("run", "csv", "engine")
"""Options that say where from, where to and how."""
_OF_RUNS = ("shape", "shift", "randomisation", "engine")
"""Options that runs have as well."""


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
    seed: Seed = 1_000_000
    """Seed of the episodes, apart from those of training and its evaluations."""
    engine: Engine = "auto"
    """Physics engine; auto is mjx on an accelerator and native on a CPU."""
    csv: str = ""
    """New file for a table of trials and successes of each seed and shape; none if empty."""


def read(argv: Sequence[str], config_of: Callable[[str], Config]) -> tuple[Evaluate, Config, str]:
    """Reads a command line; what it leaves out is as in the run.

    Args:
      config_of: the options of a run, by its folder.

    Returns:
      The options, the run's own with them in their place, and in words those that differ from the
      run's and from the defaults.

    Raises:
      UserError: the line cannot be used.
    """
    first = cli.parse(Evaluate, argv)
    own = config_of(first.run)
    arm = HELD_OUT if first.held_out else own.randomisation
    default = Evaluate(run=first.run, shape=own.shape, shift=own.shift, randomisation=arm)
    given = cli.parse(Evaluate, argv, default)
    task = dataclasses.replace(own, **{name: getattr(given, name) for name in _OF_RUNS})
    return given, task, _in_words(given, default)


def _in_words(given: Evaluate, usual: Evaluate) -> str:
    """Such as --held-out --episodes 500."""
    known, words = by_full_name(dataclasses.asdict(usual)), []
    for name, value in by_full_name(dataclasses.asdict(given)).items():
        if name in _NOT_PLAYED or value == known[name]:
            continue
        words.append(f"--{name.replace('_', '-')}")
        values = value if isinstance(value, tuple) else () if value is True else (value,)
        words += [show(part) for part in values]
    return shlex.join(words)
