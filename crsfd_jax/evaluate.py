"""`python -m crsfd_jax.evaluate RUN`: success of a trained policy, on any task."""

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from crsfd_jax import cli
from crsfd_jax.config import SHAPES, Length
from crsfd_jax.limits import Interval, OneOf


@dataclass(frozen=True)
class Evaluate:
    """Plays fresh episodes with the deterministic policies of a run and reports success."""

    run: tyro.conf.Positional[str]
    """Folder of the run."""
    shape: Annotated[str, OneOf(("", *SHAPES))] = ""
    """Digit of the peg and its socket; the run's own if not given."""
    shift: Annotated[Length, Interval(0, 0.02)] | None = None
    """Side of the square of the socket's offset, such as 4mm; the run's own if not given."""
    episodes: Annotated[int, Interval(1, 1_000_000)] = 100
    """Episodes of each seed."""
    seed: Annotated[int, Interval(0, 2_000_000_000)] = 1_000_000
    """Seed of the episodes, apart from those of training and its evaluations."""
    engine: Literal["auto", "native", "mjx", "warp"] = "auto"
    """Physics engine; auto is mjx on an accelerator and native on a CPU."""


def run(argv: list[str]) -> int:
    """Evaluates as the command line says; see --help."""
    options = cli.parse(Evaluate, argv)
    from crsfd_jax import compile_cache
    from crsfd_jax.report import success

    compile_cache.enable()
    shape = options.shape or None
    success.report(success.Options(**{**vars(options), "shape": shape}))
    return 0


if __name__ == "__main__":
    cli.main(run)
