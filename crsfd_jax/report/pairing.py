"""Which runs of a method stand for it, and which of two methods are set beside each other.

Cells come as they are gathered: of a method and variant on a task, the longest runs first.
"""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from crsfd_jax.report.cells import Cell, Task

OURS, PLAIN = "crsfd", "sacfd"
Book = dict[tuple[str, Task], list[Cell]]
Rivals = dict[str, list[tuple[Cell, Cell]]]
"""By method: one of our cells and one of its, on each task that both have."""


def index(cells: Sequence[Cell]) -> Book:
    """Cells with a method's usual options, by method and task, the longest runs first."""
    book: Book = {}
    for cell in cells:
        if not cell.variant:
            book.setdefault((cell.method, cell.task), []).append(cell)
    return book


def longest(cells: Sequence[Cell]) -> list[Cell]:
    """Of the cells of a method and variant on a task the one with the longest runs."""
    kept: dict[tuple, Cell] = {}
    for cell in cells:
        kept.setdefault((cell.method, cell.task, cell.variant), cell)
    return list(kept.values())


def of_length(cells: Sequence[Cell], steps: int) -> list[Cell]:
    """Cells that were given so many steps; what does not interact has any number of them."""
    return [cell for cell in cells if cell.planned_steps == steps or not cell.interacts]


def pairs(tasks: Sequence[tuple[Sequence[Cell], Sequence[Cell]]]) -> list[tuple[Cell, Cell]]:
    """A cell of each of two methods on each task.

    Those of as many steps on all tasks where there are such, since areas over other steps do not
    compare; then what is finished; then the most seeds and evaluations that both have.

    Args:
      tasks: the cells of both methods on each task, at least one each.
    """
    lengths = set.intersection(*(_lengths(*two) for two in tasks))
    found = [
        [_pair(*(of_length(cells, steps) for cells in two)) for two in tasks]
        for steps in sorted(lengths, reverse=True)
    ]
    return max(found or [[_pair(*two) for two in tasks]], key=lambda kept: min(map(_weight, kept)))


def rivals(cells: Sequence[Cell], ours: str) -> Rivals:
    """Every other method beside ours."""
    book, found = index(cells), {}
    for (method, task), theirs in book.items():
        if method != ours and (ours, task) in book:
            found.setdefault(method, []).append((book[ours, task], theirs))
    return {method: pairs(tasks) for method, tasks in found.items()}


def meetings(cells: Sequence[Cell]) -> Iterator[tuple[Cell, Cell]]:
    """Cells of a task and number of steps, two at a time.

    CRSfD and each method with the same options, and each method with its usual options and with
    others. What has no rival of its kind meets the usual CRSfD or SACfD.
    """
    still = [cell for cell in cells if not cell.interacts]
    places: dict[tuple[Task, int], list[Cell]] = {}
    for cell in cells:
        if cell.interacts:
            places.setdefault((cell.task, cell.planned_steps), []).append(cell)
    for (task, _), acting in places.items():
        yield from _beside([*acting, *(cell for cell in still if cell.task == task)])


def common_steps(ours: Cell, theirs: Cell) -> np.ndarray:
    """[T] environment steps at which all seeds of both were evaluated.

    A method that does not interact has its one level at any of them.
    """
    each = [_evaluated(cell) for cell in (ours, theirs) if cell.interacts]
    return np.array(sorted(set.intersection(*each))) if each else ours.curve.env_steps


def all_interact(pairs: Sequence[tuple[Cell, Cell]]) -> bool:
    """Whether every cell has a curve; of one level areas mean nothing."""
    return all(cell.interacts for pair in pairs for cell in pair)


def _pair(ours: Sequence[Cell], theirs: Sequence[Cell]) -> tuple[Cell, Cell]:
    return max(itertools.product(ours, theirs), key=_weight)


def _weight(two: tuple[Cell, Cell]) -> tuple[bool, int, int]:
    seeds = np.intersect1d(two[0].seeds, two[1].seeds)
    return all(cell.finished for cell in two), len(seeds), len(common_steps(*two))


def _lengths(ours: Sequence[Cell], theirs: Sequence[Cell]) -> set[int]:
    """Planned steps of cells that one of both methods, or each if both interact, has."""
    acting = [{c.planned_steps for c in cells if c.interacts} for cells in (ours, theirs)]
    return set.intersection(*filter(None, acting)) if any(acting) else set()


def _evaluated(cell: Cell) -> set[int]:
    return set(cell.curve.env_steps[np.isfinite(cell.curve.values).all(axis=1)].tolist())


def _beside(cells: Sequence[Cell]) -> Iterator[tuple[Cell, Cell]]:
    ours = {cell.variant: cell for cell in cells if cell.method == OURS}
    plain = {cell.variant for cell in cells if cell.method == PLAIN}
    usual = {cell.method: cell for cell in cells if not cell.variant}
    for cell in cells:
        if cell.method != OURS and (first := ours.get(cell.variant, usual.get(OURS))):
            yield first, cell
        if cell.method == OURS and cell.variant not in plain and PLAIN in usual:
            yield cell, usual[PLAIN]
        if cell.variant and cell.method in usual:
            yield cell, usual[cell.method]
