"""What the runs at hand lack, said plainly."""

from collections import Counter
from collections.abc import Iterator, Sequence

from crsfd_jax.report.cells import Cell, Task
from crsfd_jax.report.layout import TASKS, Figure
from crsfd_jax.report.methods import style
from crsfd_jax.report.pairing import longest
from crsfd_jax.report.tables import name
from crsfd_jax.report.words import counted


def lines(cells: Sequence[Cell], figures: Sequence[Figure]) -> list[str]:
    """What is unfinished, missing, or has fewer seeds or steps than others, and on which tasks."""
    places: dict[str, dict[str, None]] = {}
    for lack, place in (*_of_cells(cells), *_of_panels(figures)):
        places.setdefault(lack, {})[place] = None
    return [f"{lack}: {'; '.join(where)}" for lack, where in places.items()]


def _of_cells(cells: Sequence[Cell]) -> Iterator[tuple[str, str]]:
    usual = Counter(len(cell.seeds) for cell in cells).most_common(1)[0][0]
    planned: dict[tuple[Task, str], int] = {}
    for cell in (cell for cell in cells if cell.interacts):
        place = cell.task, cell.variant
        planned[place] = max(planned.get(place, 0), cell.planned_steps)
    kept = {id(cell) for cell in longest(cells)}
    for cell in cells:
        who, where = name(cell), str(cell.task)
        if not cell.finished:
            yield f"{who} is unfinished, {cell.steps:,} of {cell.planned_steps:,} steps", where
        others = planned.get((cell.task, cell.variant), 0)
        if cell.interacts and cell.planned_steps < others and id(cell) in kept:
            yield f"{who} was given {cell.planned_steps:,} steps, others {others:,}", where
        if len(cell.seeds) < usual:
            yield f"{who} has {counted(len(cell.seeds), 'seed')}, most have {usual}", where


def _of_panels(figures: Sequence[Figure]) -> Iterator[tuple[str, str]]:
    """Methods that a figure shows in some panels and not in others."""
    for figure in figures:
        if figure.name.startswith(TASKS):
            continue
        methods = {c.method: None for panel in figure.panels for c in panel.cells if not c.variant}
        for panel in figure.panels:
            present = {cell.method for cell in panel.cells}
            for method in methods:
                if method not in present:
                    yield f"no run of {style(method).label}", panel.title
