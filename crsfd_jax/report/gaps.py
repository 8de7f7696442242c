"""What the runs at hand lack, said plainly."""

from collections import Counter
from collections.abc import Sequence

from crsfd_jax.report.cells import Cell, Task
from crsfd_jax.report.layout import TASKS, Figure
from crsfd_jax.report.methods import style
from crsfd_jax.report.pairing import longest
from crsfd_jax.report.tables import name
from crsfd_jax.report.words import counted


def lines(cells: Sequence[Cell], figures: Sequence[Figure]) -> list[str]:
    """A line for each cell that is unfinished, missing, or has fewer seeds or steps than others."""
    usual = Counter(len(cell.seeds) for cell in cells).most_common(1)[0][0]
    planned: dict[tuple[Task, str], int] = {}
    for cell in (cell for cell in cells if cell.interacts):
        place = cell.task, cell.variant
        planned[place] = max(planned.get(place, 0), cell.planned_steps)
    kept, found = {id(cell) for cell in longest(cells)}, []
    for cell in cells:
        where = f"{cell.task}: {name(cell)}"
        if not cell.finished:
            share = f"{cell.steps:,} of {cell.planned_steps:,} steps"
            found.append(f"{where} is unfinished, {share}")
        others = planned.get((cell.task, cell.variant), 0)
        if cell.interacts and cell.planned_steps < others and id(cell) in kept:
            found.append(f"{where} was given {cell.planned_steps:,} steps, others {others:,}")
        if len(cell.seeds) < usual:
            found.append(f"{where} has {counted(len(cell.seeds), 'seed')}, most have {usual}")
    return found + _missing(figures)


def _missing(figures: Sequence[Figure]) -> list[str]:
    """Methods that a figure shows in some panels and not in others."""
    found = []
    for figure in figures:
        if figure.name.startswith(TASKS):
            continue
        methods = {c.method: None for panel in figure.panels for c in panel.cells if not c.variant}
        for panel in figure.panels:
            absent = [m for m in methods if m not in {cell.method for cell in panel.cells}]
            if absent:
                found.append(
                    f"{panel.title}: no run of {', '.join(style(m).label for m in absent)}"
                )
    return found
