"""Demonstrations that an experiment needs and that are not shipped, made before its cells run."""

import fcntl
import shlex
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from crsfd_jax.errors import STOPPED, UserError
from crsfd_jax.progress import say
from crsfd_jax.sweeps.cells import Cell, Experiment

DEMOS = (sys.executable, "-m", "crsfd_jax.demos")


def commands(experiment: Experiment, cells: Iterable[Cell]) -> dict[Path, list[str]]:
    """The files that cells read and that do not exist, and the command that makes each."""
    read = {cell.config.demos for cell in cells}
    return {
        Path(file): [*DEMOS, *arguments, "--out", file]
        for file, arguments in experiment.demos.items()
        if file in read and not Path(file).exists()
    }


def make(experiment: Experiment, cells: Iterable[Cell]) -> None:
    """Makes what is missing; another sweep that is at it is waited for.

    Raises:
      UserError: a command fails; it has said why.
    """
    for file, command in commands(experiment, cells).items():
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.with_name(f".{file.name}.lock").open("wb") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if file.exists():
                continue
            say(shlex.join(command))
            # What inherits the lock keeps it if this process dies before it.
            code = subprocess.run(command, pass_fds=[lock.fileno()]).returncode
            if not code:
                continue
            refused = file.with_name(f"refused-{file.name}")
            if file.exists():
                file.rename(refused)
            kept = f", and is kept as {refused}" if refused.exists() else ""
            raise UserError(
                f"{file}: could not be made, see above{kept}; this experiment reads it",
                code if code > 0 else STOPPED,
            )
