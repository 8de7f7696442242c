"""Every two cells that can be set beside each other, and by how much they differ.

Where two methods meet on several shapes with the same shift, the mean over the shapes stands below.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from crsfd_jax.report import summary, tables
from crsfd_jax.report.cells import Cell
from crsfd_jax.report.evidence import show, thousands
from crsfd_jax.report.methods import rank
from crsfd_jax.report.pairing import OURS, all_interact, meetings
from crsfd_jax.report.summary import LEVEL, Scores
from crsfd_jax.report.tables import Table
from crsfd_jax.report.words import by_size

_SIDE = f"final, at {LEVEL:g}, area"
_HEAD = ("shape", "first", "second", "seeds", f"first: {_SIDE}", f"second: {_SIDE}")
_HEAD += ("difference of area", "exploring", "final")


def find(cells: Sequence[Cell]) -> list[tuple[str, Table]]:
    """A title and a table for each shift and number of steps, of finished cells."""
    finished = [cell for cell in cells if cell.finished]
    groups: dict[tuple[int, float], dict[tuple, list[tuple[Cell, Cell]]]] = {}
    for ours, theirs in sorted(meetings(finished), key=_order):
        meeting = ours.method, ours.variant, theirs.method, theirs.variant, ours.is_joint
        group = groups.setdefault((ours.planned_steps, ours.task.shift_mm), {})
        group.setdefault(meeting, []).append((ours, theirs))
    found = []
    for (steps, shift), group in sorted(groups.items()):
        where = f"Shift {shift:g} mm" if shift else "No shift"
        rows = [row for pairs in group.values() for row in _rows(pairs)]
        found.append((f"{where}, {steps / 1000:g}k steps", Table(_HEAD, rows, 3)))
    return found


def _order(pair: tuple[Cell, Cell]) -> tuple:
    words = (w for c in pair for w in (c.method != OURS, rank(c.method), by_size(c.variant)))
    return (*words, pair[0].task)


def _rows(pairs: Sequence[tuple[Cell, Cell]]) -> Iterator[tuple[str, ...]]:
    names = tuple(map(tables.name, pairs[0]))
    compared = [(pair, each) for pair in pairs if (each := summary.scores(*pair))]
    for pair, each in compared:
        seeds = str(len(each.seeds))
        sides = (_side(each, i, cell) for i, cell in enumerate(pair))
        yield pair[0].task.shape_words, *names, seeds, *sides, *_gaps(pairs, [each])
    if len(compared) > 1:
        several = [each for _, each in compared]
        yield f"these {len(compared)}", *names, "", "", "", *_gaps(pairs, several)


def _side(each: Scores, side: int, cell: Cell) -> str:
    """Such as 0.993, 133k, 0.808."""
    final = f"{each.final[side].mean():.3f}"
    if not cell.interacts:
        return f"{final}, no steps"
    return f"{final}, {thousands(each.learned[side])}, {each.area[side].mean():.3f}"


def _gaps(pairs: Sequence[tuple[Cell, Cell]], found: Sequence[Scores]) -> Iterator[str]:
    """One level is no curve: what does not interact differs by its success alone."""
    acting = all_interact(pairs)
    for what in ("area", "exploring", "final"):
        estimate = summary.difference(found, what)
        is_said = np.isfinite(estimate.value) and (acting or what == "final")
        yield show(estimate, "+.3f") if is_said else "-"
