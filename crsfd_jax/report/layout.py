"""Which figures to draw and what goes into each panel: the paper's, where there are runs for them.

It follows from method, shape and shift of the runs alone.
"""

from collections.abc import Sequence
from typing import NamedTuple

from crsfd_jax.report.cells import Cell, Task
from crsfd_jax.report.methods import ARMS
from crsfd_jax.report.pairing import OURS, PLAIN, longest, of_length
from crsfd_jax.report.words import by_size

SETTING1 = tuple(Task(shape, 0.0) for shape in "1234")
SETTING2 = tuple(Task(shape, shift) for shape in "20" for shift in (4.0, 6.0, 8.0))
"""In rows; the demonstrated task, shape 0 without a shift, would stand below on the left."""
_NEW = "New shapes, socket where it was"
TASKS = "tasks"
"""Begins the names of figures of what fits into none of the paper's."""
_COLUMNS = 4


class Panel(NamedTuple):
    """One pair of axes."""

    title: str
    cells: tuple[Cell, ...]


class Figure(NamedTuple):
    """Panels with one legend."""

    name: str
    """Of its file."""
    caption: str
    columns: int
    panels: tuple[Panel, ...]


def figures(cells: Sequence[Cell]) -> list[Figure]:
    """The figures that show every method and variant of each task at least once.

    By its longest runs; on new shapes, where those hardly differ, by shorter ones too.
    """
    usual = [cell for cell in cells if not cell.variant]
    whole = [cell for cell in usual if cell.method not in ARMS]
    trained = longest(whole)
    pair = [cell for cell in trained if cell.method in (OURS, PLAIN)]
    others = {cell.task for cell in trained if cell.method not in (OURS, PLAIN)}
    wide = [task for task in SETTING2 if task in others]
    made = [
        _grid("setting1", _NEW, 2, SETTING1, trained),
        *_shorter(whole),
        _grid("setting2", "Shapes and shifts, CRSfD and SACfD", 3, SETTING2, pair),
        _grid("setting2_wide", "All methods, the socket moved", len(wide), wide, trained),
        _ablation(usual),
    ]
    made = [figure for figure in made if figure]
    drawn = {id(cell) for figure in made for panel in figure.panels for cell in panel.cells}
    return made + _others(cells, drawn)


def _shorter(cells: Sequence[Cell]) -> list[Figure | None]:
    """New shapes over each number of steps that a method has on one of them beside a larger one."""
    new = [cell for cell in cells if cell.task in SETTING1]
    kept = {id(cell) for cell in longest(new)}
    counts = {cell.planned_steps for cell in new if cell.interacts and id(cell) not in kept}
    return [
        _grid(
            f"setting1_{steps / 1000:g}k",
            f"{_NEW}, runs of {steps:,} environment steps",
            2,
            SETTING1,
            of_length(new, steps),
        )
        for steps in sorted(counts, reverse=True)
    ]


def _grid(
    name: str, caption: str, columns: int, tasks: Sequence[Task], cells: Sequence[Cell]
) -> Figure | None:
    """A figure of the paper, if it has panels and half of them have runs."""
    panels = [Panel(str(task), tuple(c for c in cells if c.task == task)) for task in tasks]
    if not panels or 2 * sum(bool(panel.cells) for panel in panels) < len(panels):
        return None
    return Figure(name, caption, columns, tuple(panels))


def _ablation(cells: Sequence[Cell]) -> Figure | None:
    """The arms, and CRSfD over as many steps, or its longest runs if it has none such."""
    arms, panels = longest([cell for cell in cells if cell.method in ARMS]), []
    for task in sorted({cell.task for cell in arms}):
        here = [cell for cell in arms if cell.task == task]
        steps = max(cell.planned_steps for cell in here)
        whole = [cell for cell in cells if (cell.method, cell.task) == (OURS, task)]
        whole.sort(key=lambda cell: cell.planned_steps != steps)
        panels.append(Panel(str(task), (*whole[:1], *here)))
    caption = "Ablation of the two conservative parts of CRSfD"
    return (
        Figure("ablation", caption, min(_COLUMNS, len(panels)), tuple(panels)) if panels else None
    )


def _others(cells: Sequence[Cell], drawn: set[int]) -> list[Figure]:
    """All methods of each task that holds a cell not drawn so far, a figure for equal steps.

    A variant that several methods have, or that no run of the task is without, is a task of its
    own: its panel's title names it, and each method looks there as everywhere. What has shorter
    runs than the longest stands beside usual runs as short, if there are such.
    """
    methods: dict[tuple[Task, str], set[str]] = {}
    for cell in cells:
        methods.setdefault((cell.task, cell.variant), set()).add(cell.method)
    usual = {(cell.task, cell.planned_steps) for cell in cells if not cell.variant}
    shorter = {(task, n) for task, n in usual if any(task == t and n < more for t, more in usual)}
    kept = {id(cell) for cell in longest(cells) if not cell.variant}

    def place(cell: Cell) -> tuple[Task, str, int]:
        apart = len(methods[cell.task, cell.variant]) > 1 or (cell.task, "") not in methods
        is_short = (cell.task, cell.planned_steps) in shorter and id(cell) not in kept
        return cell.task, cell.variant if apart else "", cell.planned_steps if is_short else 0

    def panel(task: Task, variant: str, steps: int) -> Panel:
        at = task, variant, steps
        here = [c for c in cells if at in (place(c), (c.task, c.variant, c.planned_steps))]
        title = ", ".join(filter(None, (str(task), variant)))
        return Panel(title, tuple(c._replace(variant="") if variant else c for c in here))

    places = {place(cell) for cell in cells if id(cell) not in drawn}
    panels: dict[int, list[Panel]] = {}
    for at in sorted(places, key=lambda at: (by_size(at[1]), at[0])):
        found = panel(*at)
        panels.setdefault(max(cell.planned_steps for cell in found.cells), []).append(found)
    return [
        Figure(
            f"{TASKS}_{steps / 1000:g}k",
            f"All runs of each task with {steps:,} environment steps",
            min(_COLUMNS, len(found)),
            tuple(found),
        )
        for steps, found in sorted(panels.items())
    ]
