"""`python -m crsfd_jax.evaluate RUN`: success of a trained policy, on any task."""

from pathlib import Path

from crsfd_jax import cli
from crsfd_jax.config import Config
from crsfd_jax.options import trials, validation
from crsfd_jax.options.trials import Evaluate
from crsfd_jax.storage import artefacts, files


def task_of(argv: list[str]) -> tuple[Evaluate, Config, str]:
    """What to do, the run's options with those of the command line in their place, and the latter.

    Raises:
      UserError: there is no such run, or an option cannot be used.
    """
    given, task, asked = trials.read(argv, artefacts.read_config)
    validation.validate(task)
    if given.csv:
        files.reserve(given.csv, "--csv")
    return given, task, asked


def run(argv: list[str]) -> int:
    """Evaluates as the command line says; see --help."""
    given, task, asked = task_of(argv)
    from crsfd_jax import compile_cache, success

    compile_cache.enable()
    success.report(Path(given.run), task, given.episodes, given.seed, given.csv, asked)
    return 0


if __name__ == "__main__":
    cli.main(run)
