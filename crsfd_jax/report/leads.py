"""Where CRSfD is ahead of SACfD, and by how much: a line for each task and variant of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib.figure
import numpy as np

from crsfd_jax.report.cells import Cell
from crsfd_jax.report.figures import clean, save
from crsfd_jax.report.methods import style
from crsfd_jax.report.statistics import Estimate
from crsfd_jax.report.summary import compare

OURS, THEIRS = "crsfd", "sacfd"
CAPTION = "How far CRSfD is ahead of SACfD, 95 % interval, wherever both were given as many steps."


class Lead(NamedTuple):
    """CRSfD less SACfD."""

    label: str
    """Task, variant and steps."""
    area: Estimate


def find(cells: Sequence[Cell]) -> list[Lead]:
    """The leads in area wherever both were given as many steps, by steps and task, largest first.

    Cells without a step at which both were evaluated are left out.
    """
    theirs = {_place(cell): cell for cell in cells if cell.method == THEIRS}
    found = []
    for cell in cells:
        rival = theirs.get(_place(cell)) if cell.method == OURS else None
        compared = compare([(cell, rival)]) if rival else None
        if compared:
            steps = f"{cell.planned_steps / 1000:g}k steps"
            words = filter(None, (str(cell.task), cell.variant, steps))
            order = cell.planned_steps, cell.task, -compared.area.value
            found.append((order, Lead(", ".join(words), compared.area)))
    return [lead for _, lead in sorted(found, key=lambda each: each[0])]


def draw(found: Sequence[Lead], path: Path) -> None:
    """Writes a PNG: the lead and its 95 % interval, a row each.

    Args:
      found: at least one.
    """
    canvas = matplotlib.figure.Figure((9.0, 0.9 + 0.26 * len(found)), layout="constrained")
    axes = canvas.subplots()
    clean(axes)
    row = np.arange(len(found))
    value = np.array([lead.area.value for lead in found])
    ends = np.array([(lead.area.low, lead.area.high) for lead in found]).T
    look = style(OURS)
    axes.errorbar(value, row, xerr=np.abs(ends - value), fmt="o", color=look.colour, capsize=2)
    axes.axvline(0, color=style(THEIRS).colour, linewidth=1.4)
    axes.set_yticks(row, [lead.label for lead in found])
    axes.set_ylim(len(found) - 0.5, -0.5)
    axes.set_xlabel(f"area under the curve, {look.label} less {style(THEIRS).label}", fontsize=10)
    save(canvas, path)


def _place(cell: Cell) -> tuple:
    return cell.task, cell.variant, cell.planned_steps
