"""What is said of a cell, and of two cells or two methods beside each other."""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np

from crsfd_jax.curve import Curve
from crsfd_jax.report import statistics
from crsfd_jax.report.cells import Cell
from crsfd_jax.report.pairing import common_steps
from crsfd_jax.report.statistics import Estimate

LEVEL = 0.9
"""Success rate at which a task counts as learned."""


class Summary(NamedTuple):
    """Numbers of a cell."""

    mean: float
    """Of the final success of the seeds."""
    std: float
    """Population standard deviation, as the figures draw it."""
    interquartile: Estimate
    """Interquartile mean of the final success."""
    steps_to_level: float
    """Steps at the first of three evaluations in a row at which the mean over the seeds is LEVEL
    or more; infinite if there are none."""
    seeds_at_level: int
    """Seeds that have three such evaluations."""
    area: float
    """Mean area under the curve."""
    wall_s: float


class Comparison(NamedTuple):
    """One method against another on the same tasks, positive where the first is ahead."""

    tasks: int
    steps: tuple[int, ...]
    """Environment steps of the last evaluation that both have, on each task."""
    final: Estimate
    """Difference of the final success."""
    area: Estimate
    """Difference of the area under the curve."""
    exploring: Estimate | None
    """Difference of the area under the curve of the episodes of training, in which the policy
    explores; None if a method has none."""
    middle: tuple[Estimate, Estimate]
    """Interquartile means of the areas of both."""
    better_final: Estimate
    """Chance that a seed of the first has the larger final success."""
    better_area: Estimate


class Scores(NamedTuple):
    """Scores [pairs] of seeds of two cells over the same steps, a seed beside a seed."""

    steps: int
    final: tuple[np.ndarray, np.ndarray]
    area: tuple[np.ndarray, np.ndarray]
    exploring: tuple[np.ndarray, np.ndarray]
    learned: tuple[float, float]
    """Steps at the first of three evaluations in a row at which the mean over these seeds is LEVEL
    or more; infinite if there are none."""
    seeds: np.ndarray
    """Of the first cell."""

    def gap(self, what: str) -> np.ndarray:
        """[pairs] first minus second, of final, area or exploring."""
        first, second = getattr(self, what)
        return first - second


def summarise(cell: Cell) -> Summary:
    """The numbers of a cell over the steps that all its seeds have made."""
    curve = _over(common_steps(cell, cell), cell)
    last = statistics.final(*curve)
    each = [statistics.settled_at(curve.env_steps, seed, LEVEL) for seed in curve.values.T]
    return Summary(
        mean=float(last.mean()),
        std=float(last.std()),
        interquartile=statistics.interquartile_interval([last]),
        steps_to_level=_learned(curve),
        seeds_at_level=int(np.isfinite(each).sum()),
        area=float(statistics.area(*curve).mean()),
        wall_s=sum(run.wall_s for run in cell.runs),
    )


def scores(ours: Cell, theirs: Cell) -> Scores | None:
    """Scores of the seeds that two cells of one task share, from evaluations that all have.

    If not all seeds of the smaller cell are in the other, seeds are paired in their order.

    Returns:
      None if there are none.
    """
    steps = common_steps(ours, theirs)
    if not len(steps):
        return None
    columns = _pairs(ours.seeds, theirs.seeds)
    sides = [_Side.of(steps, *each) for each in zip((ours, theirs), columns, strict=True)]
    final, area, exploring, learned = zip(*sides, strict=True)
    return Scores(int(steps[-1]), final, area, exploring, learned, ours.seeds[columns[0]])


def difference(tasks: Sequence[Scores], what: str) -> Estimate:
    """Mean over tasks of the first minus the second; NaN if a seed has no such score.

    Args:
      what: final, area or exploring.
    """
    gaps = [task.gap(what) for task in tasks]
    return statistics.mean_interval(gaps, [task.seeds for task in tasks])


def compare(pairs: Sequence[tuple[Cell, Cell]]) -> Comparison | None:
    """A method against another, on one or more tasks; None if no task has steps in common."""
    each = [task for task in (scores(ours, theirs) for ours, theirs in pairs) if task]
    if not each:
        return None
    exploring = difference(each, "exploring")
    return Comparison(
        tasks=len(each),
        steps=tuple(task.steps for task in each),
        final=difference(each, "final"),
        area=difference(each, "area"),
        exploring=exploring if np.isfinite(exploring.value) else None,
        middle=(
            statistics.interquartile_interval([task.area[0] for task in each]),
            statistics.interquartile_interval([task.area[1] for task in each]),
        ),
        better_final=statistics.improvement(*zip(*(task.final for task in each), strict=True)),
        better_area=statistics.improvement(*zip(*(task.area for task in each), strict=True)),
    )


class _Side(NamedTuple):
    """One cell of two, its seeds as they are paired."""

    final: np.ndarray
    area: np.ndarray
    exploring: np.ndarray
    learned: float

    @classmethod
    def of(cls, steps: np.ndarray, cell: Cell, columns: np.ndarray) -> Self:
        curve, explored = (
            Curve(each.env_steps, each.values[:, columns])
            for each in (_over(steps, cell), _explored(steps, cell))
        )
        scores = statistics.final(*curve), statistics.area(*curve), statistics.area(*explored)
        return cls(*scores, _learned(curve))


def _learned(curve: Curve) -> float:
    return statistics.settled_at(curve.env_steps, curve.values.mean(axis=1), LEVEL)


def _over(steps: np.ndarray, cell: Cell) -> Curve:
    """Success at these steps; of a method that does not interact, its one level."""
    return _at(steps, cell.curve) if cell.interacts else cell.curve


def _at(steps: np.ndarray, curve: Curve) -> Curve:
    rows = np.isin(curve.env_steps, steps)
    return Curve(curve.env_steps[rows], curve.values[rows])


def _explored(steps: np.ndarray, cell: Cell) -> Curve:
    """Success of the episodes of training from one of these steps to the next; NaN without any."""
    if not cell.interacts:
        return Curve(steps, np.full((len(steps), len(cell.seeds)), np.nan))
    successes, episodes = (
        np.diff(_at(steps, curve).values, axis=0, prepend=0.0) for curve in cell.exploring
    )
    rate = np.full(episodes.shape, np.nan)
    return Curve(steps, np.divide(successes, episodes, out=rate, where=episodes > 0))


def _pairs(ours: np.ndarray, theirs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns of the seeds that both cells have, in the same order."""
    _, first, second = np.intersect1d(ours, theirs, return_indices=True)
    fewer = min(len(ours), len(theirs))
    rows = np.arange(fewer)
    return (first, second) if len(first) == fewer else (rows, rows)
