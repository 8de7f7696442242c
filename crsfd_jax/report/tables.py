"""The tables of the report, as rows of words."""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from crsfd_jax.report import paper, trials
from crsfd_jax.report.cells import Cell, unusual_options
from crsfd_jax.report.evidence import show
from crsfd_jax.report.methods import style
from crsfd_jax.report.pairing import all_interact, rivals
from crsfd_jax.report.summary import LEVEL, Comparison, compare, summarise
from crsfd_jax.report.trials import Trials


class Table(NamedTuple):
    """Rows of cells below a head; the first columns hold words, the others numbers."""

    head: tuple[str, ...]
    rows: list[tuple[str, ...]]
    words: int


def results(cells: Sequence[Cell]) -> Table:
    """A row for each method on each task."""
    level = f"{LEVEL * 100:g} %"
    head = ("task", "method", "seeds", "steps", "final success", "IQM, 95 % interval")
    head += (f"steps to {level}", f"seeds at {level}", "area", "wall time")
    rows, above = [], None
    for cell in cells:
        task = str(cell.task) if cell.task != above else ""
        rows.append((task, *_result(cell)))
        above = cell.task
    return Table(head, rows, 2)


def name(cell: Cell) -> str:
    """Method and variant of a cell."""
    return ", ".join(filter(None, (style(cell.method).label, cell.variant)))


def comparisons(cells: Sequence[Cell], ours: str) -> tuple[Table, Table]:
    """One method against each other: over all tasks that both have, and task by task."""
    pairs = rivals(cells, ours)
    head = ("difference of area", "while exploring", "difference of final success")
    head += ("P(better area)", "P(better final)", "IQM of area", "of the other", "steps")
    over_all, each = (
        Table(("against", "tasks", *head), [], 1),
        Table(("task", "against", *head), [], 2),
    )
    for method, tasks in pairs.items():
        label, found = style(method).label, compare(tasks)
        if found:
            over_all.rows.append((label, str(found.tasks), *_comparison(found, tasks)))
        for pair in tasks:
            found = compare([pair])
            if found:
                each.rows.append((str(pair[0].task), label, *_comparison(found, [pair])))
    return over_all, Table(each.head, sorted(each.rows, key=lambda row: row[0]), each.words)


def transfers(found: Sequence[Trials]) -> Table:
    """Held-out trials of each shape beside the paper's on the real arm, and of all shapes."""
    rows = []
    for each in _with_sums(found, lambda each: each.label):
        known = each.shape in paper.SUCCESS
        theirs = f"{paper.SUCCESS[each.shape]:.2f}" if known else ""
        rows.append((each.label, each.shape, *_rate(each), theirs))
    head = ("method", "shape", "success, 95 % interval", "trials", paper.NAME)
    return Table(head, rows, 2)


def own_trials(found: Sequence[Trials]) -> Table:
    """Trials on each shape of the task of training, and on all of them where they are several."""
    rows = [
        (name(each.cell), str(each.cell.task), each.shape, *_rate(each))
        for each in _with_sums(found, lambda each: id(each.cell))
    ]
    return Table(("method", "trained on", "shape", "success, 95 % interval", "trials"), rows, 3)


def _with_sums(found: Sequence[Trials], kind: Callable[[Trials], Any]) -> Iterator[Trials]:
    """Trials, and behind several of a kind, which lie together, those of all."""
    for _, group in itertools.groupby(found, kind):
        several = list(group)
        yield from several
        if len(several) > 1:
            yield trials.together(several)


def _rate(each: Trials) -> tuple[str, str]:
    return show(each.rate), f"{each.successes.sum()} of {each.trials.sum()}"


def machines(cells: Sequence[Cell]) -> Table:
    """What the runs were made on and with, and when."""
    groups: dict[tuple[str, str], list] = {}
    for run in (run for cell in cells for run in cell.runs):
        told = run.manifest
        text = ", ".join(f"{package} {version}" for package, version in told.versions.items())
        groups.setdefault((told.device, text), []).append(run)
    rows = []
    for (device, versions), runs in groups.items():
        dates = sorted(run.manifest.started[:10] or "not recorded" for run in runs)
        span = dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
        wall = duration(math.fsum(run.wall_s for run in runs))
        rows.append((device, versions, span, str(len(runs)), wall))
    return Table(("device", "versions", "started", "runs", "wall time"), rows, 2)


def options(cells: Sequence[Cell]) -> Table:
    """Options that are not at their default, of each method."""
    rows = [
        (style(method).label, ", ".join(f"{name} {value}" for name, value in found.items()))
        for method, found in unusual_options(cells).items()
    ]
    return Table(("method", "options"), [row for row in rows if row[1]], 2)


def made_of(cells: Sequence[Cell]) -> list[str]:
    """Both of these as lines."""
    lines = [
        f"{count} runs on {device}, started {span}, {wall} in all, with {versions}"
        for device, versions, span, count, wall in machines(cells).rows
    ]
    methods: dict[str, list[str]] = {}
    for method, found in options(cells).rows:
        methods.setdefault(found, []).append(method)
    return lines + [f"{', '.join(names)}: {found}" for found, names in methods.items()]


def duration(seconds: float) -> str:
    """Hours and minutes, or seconds of a short time."""
    if not math.isfinite(seconds):
        return "not recorded"
    if seconds < 120:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min"


def _result(cell: Cell) -> tuple[str, ...]:
    found = summarise(cell)
    reached = f"{found.steps_to_level:,.0f}"
    if not math.isfinite(found.steps_to_level):
        reached = "not reached"
    curve = f"{cell.steps:,}", reached, f"{found.area:.3f}"
    steps, reached, area = curve if cell.interacts else ("no interaction", "", "")
    return (
        name(cell),
        str(len(cell.seeds)),
        steps,
        f"{found.mean:.3f} ± {found.std:.3f}",
        show(found.interquartile),
        reached,
        f"{found.seeds_at_level} of {len(cell.seeds)}",
        area,
        duration(found.wall_s),
    )


def _comparison(found: Comparison, pairs: Sequence[tuple[Cell, Cell]]) -> tuple[str, ...]:
    """One level is no curve: a method that does not interact is compared by its success alone."""
    low, high = min(found.steps), max(found.steps)
    acting = all_interact(pairs)
    return (
        show(found.area, "+.3f") if acting else "-",
        show(found.exploring, "+.3f") if found.exploring else "-",
        show(found.final, "+.3f"),
        show(found.better_area, ".2f") if acting else "-",
        show(found.better_final, ".2f"),
        *(show(middle) if acting else "-" for middle in found.middle),
        f"{low:,}" if low == high else f"{low:,} to {high:,}",
    )
