"""Trials of trained policies on the task that they were trained for, one for several shapes too."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from crsfd_jax.errors import UserError
from crsfd_jax.report import transfer
from crsfd_jax.report.cells import Task, task_of
from crsfd_jax.report.methods import rank
from crsfd_jax.storage import manifest, run_folder


class Trials(NamedTuple):
    """All trials of the policies of a run on one shape."""

    task: Task
    """That of training; its shape may stand for several."""
    method: str
    shape: str
    """In the trials."""
    successes: int
    trials: int


def find(roots: Sequence[str | Path]) -> tuple[list[Trials], list[str]]:
    """Reads the tables in and below folders that a sweep has had written for its cells.

    Returns:
      Trials by task, method and shape, and a line for each file that cannot be used.
    """
    found, skipped = [], []
    for path in sorted({path for root in roots for path in _tables(Path(root))}):
        try:
            if described := transfer.config_of(path):
                config = manifest.read(described).config
                counted = transfer.totals(path).items()
                task = task_of(config)
                found += [Trials(task, config.algorithm, shape, *n) for shape, n in counted]
        except UserError as error:
            skipped.append(str(error))
    return sorted(found, key=lambda t: (t.task, rank(t.method), t.shape)), skipped


def _tables(root: Path) -> set[Path]:
    return set(root.rglob(f"*{run_folder.at('').trials.name}")) - set(transfer.tables(root))
