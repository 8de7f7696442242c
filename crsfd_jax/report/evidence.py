"""Verdicts from intervals: when a statement holds, when it does not, when it is left open."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from crsfd_jax.report import statistics, summary
from crsfd_jax.report.cells import Cell, Task
from crsfd_jax.report.methods import style
from crsfd_jax.report.pairing import Book, pairs
from crsfd_jax.report.statistics import Estimate
from crsfd_jax.report.trials import Trials
from crsfd_jax.report.words import counted

HOLDS, FAILS, OPEN = "holds", "does not hold", "undecided"
MARGIN = 0.05
"""Difference of success rate or area that counts as none."""
FEWEST_SEEDS = 3
_TRANSFER = "CRSfD, 2 mm, randomised"
"""The label of the trials that stand for the paper's."""
RULES = (
    "A claim holds if all its comparisons hold, and does not hold if one does not, with no "
    "allowance for how many they are.",
    "Every number is a mean with its 95 % interval: Student's t over seeds, of held-out trials "
    "Wilson's where that is wider.",
    "X over Y holds if the interval of the difference lies above 0, however little, and else does "
    f"not if it lies below {MARGIN:g}; alike: it lies within ±{MARGIN:g}.",
    f"X like Y holds if the interval lies within ±{MARGIN:g}, and does not if it lies "
    f"outside. X no worse than Y holds above -{MARGIN:g}, and does not below.",
    "X below a level holds if its interval lies below it, and does not if it lies above.",
    "Trials succeed as the paper's do if their interval lies above the paper's rate minus "
    f"{MARGIN:g}, and do not if it lies below.",
    "Steps to a level are compared as they are, without an interval; equal ones decide nothing.",
    f"The rest is undecided, and so is what has no finished runs with {FEWEST_SEEDS} seeds.",
    "Two methods are compared by the evaluations that both have, up to the steps named; these are "
    "whole calls of the compiled program, 41k where 40k were asked for. Of runs over several "
    "numbers of steps those with more seeds count, then those with more evaluations.",
)


class Part(NamedTuple):
    """One comparison, and the numbers that decide it."""

    verdict: str
    numbers: str


class Claim(NamedTuple):
    """A statement of the paper."""

    statement: str
    verdict: str
    parts: tuple[Part, ...]


def claim(statement: str, parts: Sequence[Part]) -> Claim:
    """Holds if all parts hold, does not if one does not, and is undecided otherwise."""
    verdicts = {part.verdict for part in parts}
    verdict = FAILS if FAILS in verdicts else OPEN if OPEN in verdicts else HOLDS
    return Claim(statement, verdict, tuple(parts))


def ahead(book: Book, tasks: Sequence[Task], ours: str, theirs: str, what: str) -> Part:
    """Whether a method scores above another, on the mean over tasks.

    Args:
      what: final or area.
    """
    where = str(tasks[0]) if len(tasks) == 1 else f"{len(tasks)} tasks"
    subject = f"{where}, {_WORDS[what]}: {_label(ours)} over {_label(theirs)}"
    each = _scores(book, tasks, ours, theirs)
    if isinstance(each, str):
        return Part(OPEN, f"{subject}: {each}")
    found = summary.difference(each, what)
    verdict = HOLDS if found.low > 0 else FAILS if found.high < MARGIN else OPEN
    alike = ", alike" * (verdict == FAILS and found.low > -MARGIN)
    more = f"{alike}{_while_exploring(each) if what == 'area' else ''}"
    return Part(verdict, f"{subject} {show(found, '+.3f')}{more}, {_steps(each)}")


def close(book: Book, task: Task, ours: str, theirs: str, what: str) -> Part:
    """Whether two methods score alike."""

    def judge(found: Estimate) -> str:
        within = found.low > -MARGIN and found.high < MARGIN
        outside = found.low > MARGIN or found.high < -MARGIN
        return HOLDS if within else FAILS if outside else OPEN

    return _judged(book, task, (ours, "like", theirs), what, judge)


def no_worse(book: Book, task: Task, ours: str, theirs: str) -> Part:
    """Whether a method ends as high as another, or higher."""

    def judge(found: Estimate) -> str:
        return HOLDS if found.low > -MARGIN else FAILS if found.high < -MARGIN else OPEN

    return _judged(book, task, (ours, "no worse than", theirs), "final", judge)


def later(book: Book, task: Task, ours: str, theirs: str) -> Part:
    """Whether a method comes to the level that counts as learned after ours, or not at all."""
    subject = f"{task}, steps to {summary.LEVEL:g}: {_label(theirs)} against {_label(ours)}"
    each = _scores(book, [task], ours, theirs)
    if isinstance(each, str):
        return Part(OPEN, f"{subject}: {each}")
    first, second = each[0].learned
    said = " against ".join(thousands(steps) for steps in (second, first))
    verdict = HOLDS if first < second else FAILS if first > second else OPEN
    return Part(verdict, f"{subject} {said}, {_steps(each)}")


def wider(book: Book, far: Sequence[Task], near: Sequence[Task]) -> Part:
    """Whether the gap from CRSfD to SACfD is larger on some tasks than on others."""
    subject = f"margin on {_names(far)} over that on {_names(near)}"
    each = _scores(book, [*far, *near], "crsfd", "sacfd")
    if isinstance(each, str):
        return Part(OPEN, f"{subject}: {each}")
    gaps, seeds = [task.gap("area") for task in each], [task.seeds for task in each]
    weights = [1 / len(far)] * len(far) + [-1 / len(near)] * len(near)
    found = statistics.weighted_interval(gaps, seeds, weights)
    verdict = HOLDS if found.low > 0 else FAILS if found.high < MARGIN else OPEN
    return Part(verdict, f"{subject} {show(found, '+.3f')}, {_steps(each)}")


def below(book: Book, task: Task, method: str, level: float) -> Part:
    """Whether the final success of a method stays below a level."""
    subject = f"{task}: {_label(method)}"
    cells = _usable(book, method, task)
    if not cells:
        return Part(OPEN, f"{subject}: no run of {_label(method)}")
    cell = max(cells, key=lambda each: len(each.seeds))
    if lacking := _lacking(cell):
        return Part(OPEN, f"{subject}: {lacking}")
    found = statistics.mean_interval([statistics.final(*cell.curve)], [cell.seeds])
    found = Estimate(*np.clip(found, 0, 1).tolist())
    verdict = HOLDS if found.high < level else FAILS if found.low >= level else OPEN
    steps = f", {cell.steps / 1000:.0f}k steps" * cell.interacts
    return Part(verdict, f"{subject} {show(found)}{steps}")


def above(found: Sequence[Trials], shape: str, rate: float) -> Part:
    """Whether held-out trials of CRSfD succeed nearly as often as the paper's on the arm."""
    of_shape = [t for t in found if t.held_out and t.shape == shape and t.label == _TRANSFER]
    if not of_shape:
        return Part(OPEN, f"shape {shape}: no held-out trials")
    trials, bar = of_shape[0], rate - MARGIN
    if lacking := _lacking(trials.cell, np.unique(trials.seeds)):
        return Part(OPEN, f"shape {shape}: {lacking}")
    verdict = HOLDS if trials.rate.low > bar else FAILS if trials.rate.high < bar else OPEN
    said = f"{show(trials.rate)} of {trials.trials.sum()} trials"
    return Part(verdict, f"shape {shape}: {said}, paper {rate:g}")


def show(estimate: Estimate, form: str = ".3f") -> str:
    """A number and its interval, such as 0.912 [0.880, 0.944]."""
    return f"{estimate.value:{form}} [{estimate.low:{form}}, {estimate.high:{form}}]"


def thousands(steps: float) -> str:
    """Steps, which may be infinite, in words."""
    return f"{steps / 1000:.0f}k" if np.isfinite(steps) else "not reached"


_WORDS = {"final": "final success", "area": "area"}


def _judged(
    book: Book, task: Task, said: tuple[str, str, str], what: str, judge: Callable[[Estimate], str]
) -> Part:
    """What is judged of the score of one method minus that of another.

    Args:
      said: the first method, how it is said to compare, and the second.
    """
    ours, relation, theirs = said
    subject = f"{task}, {_WORDS[what]}: {_label(ours)} {relation} {_label(theirs)}"
    each = _scores(book, [task], ours, theirs)
    if isinstance(each, str):
        return Part(OPEN, f"{subject}: {each}")
    found = summary.difference(each, what)
    return Part(judge(found), f"{subject} {show(found, '+.3f')}, {_steps(each)}")


def _while_exploring(each: Sequence[summary.Scores]) -> str:
    """The difference by the episodes of training in words, if all have some; it decides nothing."""
    found = summary.difference(each, "exploring")
    return f", while exploring {show(found, '+.3f')}" if np.isfinite(found.value) else ""


def _scores(
    book: Book, tasks: Sequence[Task], ours: str, theirs: str
) -> list[summary.Scores] | str:
    """Scores of two methods on each task, or what is missing for them, in words."""
    usable = [(_usable(book, ours, task), _usable(book, theirs, task)) for task in tasks]
    found = []
    places = [f" on {task}" if len(tasks) > 1 else "" for task in tasks]
    for (first, second), where in zip(usable, places, strict=True):
        if not first or not second:
            return f"no run of {_label(theirs if first else ours)}{where}"
    for two, where in zip(pairs(usable), places, strict=True):
        lacking = _lacking(two[0]) or _lacking(two[1])
        if lacking:
            return lacking + where
        scores = summary.scores(*two)
        if scores is None:
            return f"no evaluations at the same steps{where}"
        found.append(scores)
    return found


def _steps(each: Sequence[summary.Scores]) -> str:
    """Up to which step methods are compared, such as 60k steps."""
    ends = dict.fromkeys(f"{end(task.steps for task in each) / 1000:.0f}k" for end in (min, max))
    return f"{' to '.join(ends)} steps"


def _usable(book: Book, method: str, task: Task) -> list[Cell]:
    """The cells that lack nothing, the longest runs first; all of them if there is none."""
    cells = book.get((method, task), [])
    return [cell for cell in cells if not _lacking(cell)] or cells


def _lacking(cell: Cell, seeds: np.ndarray | None = None) -> str:
    """What a cell, or these seeds of it, lack for a verdict, in words; empty if nothing."""
    seeds = cell.seeds if seeds is None else seeds
    if not cell.finished:
        stand = f"{cell.steps:,} of {cell.planned_steps:,} steps"
        return f"{_label(cell.method)} stands at {stand}"
    if len(seeds) < FEWEST_SEEDS:
        return f"{_label(cell.method)} has {counted(len(seeds), 'seed')}"
    return ""


def _names(tasks: Sequence[Task]) -> str:
    if len(tasks) == 1:
        return str(tasks[0])
    return f"shape {tasks[0].shape}, {len(tasks)} shifts"


def _label(method: str) -> str:
    return style(method).label
