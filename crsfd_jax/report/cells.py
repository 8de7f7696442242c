"""Runs of the same method on the same task, put together: a cell of a table."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from crsfd_jax.config import Config, to_dict
from crsfd_jax.curve import Curve
from crsfd_jax.options import shapes
from crsfd_jax.options.names import MAY_CHANGE, by_full_name
from crsfd_jax.report.methods import WITHOUT_INTERACTION, method_of, rank
from crsfd_jax.report.runs import Exploring, Run
from crsfd_jax.report.statistics import final
from crsfd_jax.report.words import in_words

# What a run is told apart by, or what says nothing about what is learned.
_ASIDE = {"algorithm", "shape", "shift", "seed", "seeds", "steps", "replay.capacity"}
_ASIDE |= {*MAY_CHANGE} - {"engine"}
_OWN = "potential.", "replay.draw_demos"
"""Options that mean something to some methods only, or another thing."""


class Task(NamedTuple):
    """What is inserted where."""

    shape: str
    shift_mm: float
    grids: str = ""
    """Of shapes that are the user's own: another grid of the same name is another task."""

    @property
    def shape_words(self) -> str:
        """The shapes, those that are the user's own with their grids."""
        return self.grids or self.shape

    def __str__(self) -> str:
        shift = f"shift {self.shift_mm:g} mm" if self.shift_mm else "no shift"
        shape = "all shapes" if self.shape_words == shapes.ALL else f"shape {self.shape_words}"
        return f"{shape}, {shift}"


def task_of(config: Config) -> Task:
    """The task of a run with these options."""
    grids = config.shape if "=" in config.shape else ""
    return Task(shapes.label(config.shape), round(config.shift * 1e3, 6), grids)


class Cell(NamedTuple):
    """A method on a task."""

    method: str
    task: Task
    variant: str
    """Options in which it differs from most runs, in words, other words for other options; empty
    for most."""
    curve: Curve
    """Success of all seeds; without interaction, the final one at 0 steps."""
    exploring: Exploring
    seeds: np.ndarray
    """[S] of the columns of `curve`."""
    planned_steps: int
    """Environment steps of each seed that its runs were to make."""
    runs: tuple[Run, ...]

    @property
    def steps(self) -> int:
        """Environment steps that every seed has made."""
        return min(_last(run) for run in self.runs)

    @property
    def finished(self) -> bool:
        """Whether every seed has made its planned steps."""
        return self.steps >= self.planned_steps

    @property
    def interacts(self) -> bool:
        """Whether environment steps mean anything to the method."""
        return self.method not in WITHOUT_INTERACTION

    @property
    def is_joint(self) -> bool:
        """Whether one policy is for several shapes."""
        return len(shapes.read(self.runs[0].manifest.config.shape)) > 1


def gather(runs: Sequence[Run]) -> tuple[list[Cell], list[str]]:
    """Sorts runs into cells; of the same seed twice, the longer run counts.

    Runs of another number of steps are another cell: their areas do not compare. What is unfinished
    waits while there are finished runs of its cell.

    Returns:
      Cells, by task and then by method, the longest runs first, and a line for each run that is
      left out.
    """
    usual = _usual_options(runs)
    groups: dict[tuple, list[Run]] = {}
    for run in runs:
        config = run.manifest.config
        method = method_of(config)
        changed = _changed(run.options, usual[method]) | _unusual_buffer(config)
        place = method, task_of(config), tuple(changed.items()), config.steps
        groups.setdefault(place, []).append(run)
    variants = _variants({changed: group[0] for (_, _, changed, _), group in groups.items()})
    cells, left_out = [], []
    for (method, task, changed, steps), group in groups.items():
        kept, repeated = _without_repeats(group)
        kept, waiting = _finished(kept, steps)
        left_out += [*repeated, *waiting]
        cells.append(_cell(method, task, variants[changed], steps, kept))
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

    All but their own is counted over all methods: they are compared where they have it alike.
    """
    default, seen = by_full_name(to_dict(Config())), {}
    for run in runs:
        for name, value in run.options.items():
            method = method_of(run.manifest.config) if name.startswith(_OWN) else ""
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


def _unusual_buffer(config: Config) -> dict[str, int]:
    """The capacity of a buffer that holds another share of the run than it usually would."""
    own, usual = (min(x.replay.capacity, config.steps) for x in (config, Config()))
    return {} if own == usual else {"replay.capacity": config.replay.capacity}


def _matters(name: str) -> bool:
    return name not in _ASIDE and not name.startswith("evaluation.")


def _variants(changed: Mapping[tuple, Run]) -> dict[tuple, str]:
    """Words for each set of options, a run of which is given; a number tells equal words apart."""
    words, used = {}, Counter()
    for options, run in changed.items():
        said = in_words(dict(options), run.manifest.config.randomisation)
        used[said] += 1
        words[options] = said if used[said] == 1 else f"{said} ({used[said]})"
    return words


def _finished(runs: Sequence[Run], steps: int) -> tuple[list[Run], list[str]]:
    """The finished runs, and a line for each other; all runs if none is finished."""
    ended: dict[bool, list[Run]] = {True: [], False: []}
    for run in runs:
        ended[_last(run) >= steps].append(run)
    if not ended[True]:
        return ended[False], []
    said = "waits for its end: other seeds are there"
    lines = [f"{run.name}: {_last(run):,} of {steps:,} steps, {said}" for run in ended[False]]
    return ended[True], lines


def _last(run: Run) -> int:
    return int(run.curve.env_steps[-1])


def _without_repeats(runs: Sequence[Run]) -> tuple[list[Run], list[str]]:
    kept, lines = [], []
    for run in sorted(runs, key=lambda run: (-_last(run), -len(run.seeds), run.name)):
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
        exploring=Exploring(*map(_beside, zip(*(run.exploring for run in runs), strict=True))),
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
