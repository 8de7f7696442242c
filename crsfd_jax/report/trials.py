"""Trials of trained policies: under conditions that training never saw, or of its own task."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crsfd_jax.errors import UserError
from crsfd_jax.intervals import rate_interval
from crsfd_jax.options.randomisation import Randomisation
from crsfd_jax.report import words
from crsfd_jax.report.cells import Cell
from crsfd_jax.report.methods import rank, style
from crsfd_jax.report.pairing import longest
from crsfd_jax.report.statistics import Estimate
from crsfd_jax.storage import run_folder
from crsfd_jax.storage import trials as table
from crsfd_jax.storage.trials import Row

_HELD_OUT = ("--held-out",)
_NUMBER = ("--episodes", "--seed")
"""Options that say how many episodes are played, and which."""


class Trials(NamedTuple):
    """All trials of the policies of a cell on one shape."""

    cell: Cell
    shape: str
    held_out: bool
    """Under a randomisation that training never saw; else on the task of training."""
    seeds: np.ndarray
    """[S]."""
    successes: np.ndarray
    """[S] of each seed."""
    trials: np.ndarray
    """[S]."""

    @property
    def rate(self) -> Estimate:
        """Success rate of all seeds."""
        rate = float(self.successes.sum() / self.trials.sum())
        return Estimate(rate, *rate_interval(self.successes, self.trials))

    @property
    def drawn(self) -> Randomisation:
        """What was drawn in training."""
        return self.cell.runs[0].manifest.config.randomisation

    @property
    def label(self) -> str:
        """Method and training, in words."""
        word = words.DRAWN.get(self.drawn, "" if self.cell.variant else "randomised otherwise")
        unusual = (w for w in self.cell.variant.split(", ") if w not in words.DRAWN.values())
        joint = "one policy for several shapes" * self.cell.is_joint
        shift = f"{self.cell.task.shift_mm:g} mm"
        method = style(self.cell.method).label
        return ", ".join(filter(None, (method, joint, shift, word, *unusual)))


def find(roots: Sequence[str | Path], cells: Sequence[Cell]) -> tuple[list[Trials], list[str]]:
    """Reads the tables in and below folders that belong to runs of the cells.

    A table belongs to the run in whose folder it lies, or to the NAME.json that its name begins
    with. Of several tables of a run under the same conditions, that with the most trials counts.

    Returns:
      Trials, held-out ones first, by training, method, task and shape, and a line for each table
      that is not used.
    """
    owners = {run.described.resolve(): cell for cell in longest(cells) for run in cell.runs}
    largest: dict[tuple[Path, bool], list[Row]] = {}
    skipped = []
    for path in sorted({path.resolve() for root in roots for path in Path(root).rglob("*.csv")}):
        try:
            if rows := table.read(path):
                run, held_out = _described(path), _is_held_out(path, rows)
                if run is None or run not in owners:
                    raise UserError(f"{path}: trials of no run that is shown, or of a shorter one")
                others = largest.get((run, held_out), [])
                largest[run, held_out] = max(others, rows, key=lambda r: sum(x.trials for x in r))
        except UserError as error:
            skipped.append(str(error))
    return sorted(_summed(largest, owners), key=_place), skipped


def together(found: Sequence[Trials]) -> Trials:
    """Trials on several shapes as of one; a seed is the same on all."""
    seeds, rows = np.unique(np.concatenate([each.seeds for each in found]), return_inverse=True)
    successes = np.concatenate([each.successes for each in found])
    trials = np.concatenate([each.trials for each in found])
    return found[0]._replace(
        shape="all",
        seeds=seeds,
        successes=np.bincount(rows, successes).astype(int),
        trials=np.bincount(rows, trials).astype(int),
    )


def _is_held_out(path: Path, rows: Sequence[Row]) -> bool:
    """Whether trials are under the held-out randomisation; they are of the run's own task if not.

    Raises:
      UserError: they are of neither, or of both.
    """
    asked = set()
    for options in {row.options for row in rows}:
        given = shlex.split(options)
        for name in _NUMBER:
            if name in given:
                del given[given.index(name) : given.index(name) + 2]
        asked.add(tuple(given))
    if len(asked) > 1 or not asked <= {(), _HELD_OUT}:
        said = "; ".join(" ".join(given) for given in sorted(asked))
        raise UserError(f"{path}: trials under conditions of their own ({said})")
    return asked == {_HELD_OUT}


def _described(path: Path) -> Path | None:
    """The file that describes the run of a table."""
    described = [file for file in path.parent.glob("*.json") if path.stem.startswith(file.stem)]
    described += [file for file in [run_folder.at(path.parent).config] if file.exists()]
    return max(described, key=lambda file: len(file.stem), default=None)


def _summed(
    largest: Mapping[tuple[Path, bool], Sequence[Row]], owners: Mapping[Path, Cell]
) -> list[Trials]:
    """The rows of all runs of a cell, put together by shape."""
    rows_of: dict[tuple[int, str, bool], list[Row]] = {}
    cell_of = {id(cell): cell for cell in owners.values()}
    for (run, held_out), rows in largest.items():
        for row in rows:
            rows_of.setdefault((id(owners[run]), row.shape, held_out), []).append(row)
    return [
        Trials(
            cell_of[mark],
            shape,
            held_out,
            np.array([row.seed for row in rows]),
            np.array([row.successes for row in rows]),
            np.array([row.trials for row in rows]),
        )
        for (mark, shape, held_out), rows in rows_of.items()
    ]


def _place(trials: Trials) -> tuple:
    cell = trials.cell
    drawn = [*words.DRAWN]
    order = drawn.index(trials.drawn) if trials.drawn in drawn else len(drawn)
    return not trials.held_out, order, rank(cell.method), cell.variant, cell.task, trials.shape
