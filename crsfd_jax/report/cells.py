"""Runs of the same method on the same task, put together: a cell of a table."""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from crsfd_jax.config import Config, to_dict
from crsfd_jax.curve import Curve
from crsfd_jax.options import shapes
from crsfd_jax.options.names import MAY_CHANGE, by_full_name
from crsfd_jax.report.methods import WITHOUT_INTERACTION, method_of, rank
from crsfd_jax.report.runs import Run
from crsfd_jax.report.statistics import final
from crsfd_jax.report.words import in_words

# What a run is told apart by, or what says nothing about what is learned.
_ASIDE = {"algorithm", "shape", "shift", "seed", "seeds", "steps", "replay.capacity"}
_ASIDE |= {*MAY_CHANGE} - {"engine"}
_TASK = ("scene.", "mdp.", "randomisation.")
"""Options that define the task, besides shape and shift."""


class Task(NamedTuple):
    """What is inserted where."""

    shape: str
    shift_mm: float

    def __str__(self) -> str:
        shift = f"shift {self.shift_mm:g} mm" if self.shift_mm else "no shift"
        return f"shape {self.shape}, {shift}"


def task_of(config: Config) -> Task:
    """The task of a run with these options."""
    return Task(shapes.label(config.shape), round(config.shift * 1e3, 6))


class Cell(NamedTuple):
    """A method on a task."""

    method: str
    task: Task
    variant: str
    """Options in which it differs from the method's other runs, in words; empty for most."""
    curve: Curve
    """Success of all seeds; without interaction, the final one at 0 steps."""
    exploring: Curve
    """Success of the episodes of training; NaN where there were none."""
    seeds: np.ndarray
    """[S] of the columns of `curve`."""
    planned_steps: int
    """Environment steps of each seed that its runs were to make."""
    runs: tuple[Run, ...]

    @property
    def steps(self) -> int:
        """Environment steps that every seed has made."""
        return min(int(run.curve.env_steps[-1]) for run in self.runs)

    @property
    def finished(self) -> bool:
        """Whether every seed has made its planned steps."""
        return not self.interacts or self.steps >= self.planned_steps

    @property
    def interacts(self) -> bool:
        """Whether environment steps mean anything to the method."""
        return self.method not in WITHOUT_INTERACTION


def gather(runs: Sequence[Run]) -> tuple[list[Cell], list[str]]:
    """Sorts runs into cells; of the same seed twice, the longer run counts.

    Runs of another number of steps are another cell: their areas do not compare.

    Returns:
      Cells, by task and then by method, the longest runs first, and a line for each run that is
      left out.
    """
    usual = _usual_options(runs)
    groups: dict[tuple, list[Run]] = {}
    for run in runs:
        config = run.manifest.config
        method = method_of(config)
        changed = _changed(run.options, usual[method])
        place = method, task_of(config), tuple(changed.items()), config.steps
        groups.setdefault(place, []).append(run)
    cells, left_out = [], []
    for (method, task, changed, steps), group in groups.items():
        kept, lines = _without_repeats(group)
        left_out += lines
        cells.append(_cell(method, task, in_words(dict(changed)), steps, kept))
    cells.sort(key=lambda c: (c.task, rank(c.method), c.variant, -c.planned_steps))
    return cells, left_out


def unusual_options(cells: Iterable[Cell]) -> dict[str, dict[str, Any]]:
    """For each method, the options that its usual runs give another value than the default."""
    default = by_full_name(to_dict(Config()))
    usual = _usual_options([run for cell in cells for run in cell.runs])
    return {
        method: {n: v for n, v in options.items() if _matters(n) and v != default.get(n)}
        for method, options in usual.items()
    }


def _usual_options(runs: Sequence[Run]) -> dict[str, dict[str, Any]]:
    """For each method, each option's most frequent value; at a tie the default if it is there.

    What defines the task is counted over all methods: they are compared on the same parts.
    """
    default, seen = by_full_name(to_dict(Config())), {}
    for run in runs:
        for name, value in run.options.items():
            method = "" if name.startswith(_TASK) else method_of(run.manifest.config)
            seen.setdefault((method, name), Counter())[value] += 1
    usual = {method_of(run.manifest.config): {} for run in runs}
    for (method, name), counter in seen.items():
        most = max(counter, key=lambda v, c=counter, n=name: (c[v], v == default.get(n)))
        for options in [usual[method]] if method else usual.values():
            options[name] = most
    return usual


def _changed(options: dict[str, Any], usual: dict[str, Any]) -> dict[str, Any]:
    names = (name for name in sorted(options) if _matters(name))
    return {name: options[name] for name in names if options[name] != usual.get(name)}


def _matters(name: str) -> bool:
    return name not in _ASIDE and not name.startswith("evaluation.")


def _without_repeats(runs: Sequence[Run]) -> tuple[list[Run], list[str]]:
    kept, lines = [], []
    for run in sorted(runs, key=lambda run: (-run.curve.env_steps[-1], run.name)):
        same = [other for other in kept if set(other.seeds) & set(run.seeds)]
        if same:
            lines.append(f"{run.name}: repeats seeds of {same[0].name}, which is at least as long")
        else:
            kept.append(run)
    return kept, lines


def _cell(method: str, task: Task, variant: str, planned: int, runs: Sequence[Run]) -> Cell:
    runs = sorted(runs, key=lambda run: run.seeds[0])
    curve = _beside([run.curve for run in runs])
    if method in WITHOUT_INTERACTION:
        curve = Curve(np.zeros(1, np.int64), final(*curve)[None])
    return Cell(
        method=method,
        task=task,
        variant=variant,
        curve=curve,
        exploring=_beside([run.exploring for run in runs]),
        seeds=np.concatenate([run.seeds for run in runs]),
        planned_steps=planned,
        runs=tuple(runs),
    )


def _beside(curves: Sequence[Curve]) -> Curve:
    """The seeds of several curves at the steps of all; NaN where one has none."""
    steps = np.unique(np.concatenate([curve.env_steps for curve in curves]))
    parts = []
    for curve in curves:
        part = np.full((len(steps), curve.values.shape[1]), np.nan)
        part[np.searchsorted(steps, curve.env_steps)] = curve.values
        parts.append(part)
    return Curve(steps, np.concatenate(parts, axis=1))
