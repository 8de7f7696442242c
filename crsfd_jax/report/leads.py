"""Where CRSfD is ahead of SACfD, and by how much: a row for each task and variant of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes

from crsfd_jax.drawing.axes import clean
from crsfd_jax.report.cells import Cell
from crsfd_jax.report.figures import save
from crsfd_jax.report.methods import style
from crsfd_jax.report.pairing import OURS, PLAIN, meetings
from crsfd_jax.report.statistics import Estimate
from crsfd_jax.report.summary import compare
from crsfd_jax.report.words import by_size

CAPTION = (
    "How far CRSfD is ahead of SACfD, 95 % interval, wherever both were given as many steps. "
    "Hollow: by the episodes of training, in which the policy explores."
)
_BELOW = 0.28
"""Rows that the second mark stands below the first."""


class Lead(NamedTuple):
    """CRSfD minus SACfD."""

    label: str
    """Task, variant and steps."""
    area: Estimate
    exploring: Estimate | None
    """The same by the episodes of training."""


def find(cells: Sequence[Cell]) -> list[Lead]:
    """The leads in area wherever both were given as many steps: by steps, variant and task.

    CRSfD has its usual options, or the same as SACfD.

    Cells without a step at which both were evaluated are left out.
    """
    found = []
    for ours, theirs in meetings(cells):
        if (ours.method, theirs.method) != (OURS, PLAIN):
            continue
        compared = ours.variant in ("", theirs.variant) and compare([(ours, theirs)])
        if compared:
            steps, options = f"{ours.planned_steps / 1000:g}k steps", _options(ours, theirs)
            label = ", ".join(filter(None, (str(ours.task), options, steps)))
            order = ours.planned_steps, by_size(options), ours.task
            found.append((order, Lead(label, compared.area, compared.exploring)))
    return [lead for _, lead in sorted(found, key=lambda each: each[0])]


def draw(found: Sequence[Lead], path: Path) -> None:
    """Writes a PNG: the lead and its 95 % interval, a row each.

    Args:
      found: at least one.
    """
    canvas = matplotlib.figure.Figure((9.0, 0.9 + 0.3 * len(found)), layout="constrained")
    axes = canvas.subplots()
    clean(axes)
    look = style(OURS)
    areas, exploring = [lead.area for lead in found], [lead.exploring for lead in found]
    _mark(axes, areas, 0.0, look.colour, label="evaluations")
    label = "episodes of training, exploring"
    _mark(axes, exploring, _BELOW, look.colour, mfc="white", alpha=0.6, label=label)
    axes.axvline(0, color=style(PLAIN).colour, linewidth=1.4)
    axes.set_yticks(range(len(found)), [lead.label for lead in found])
    axes.set_ylim(len(found) - 0.5, -0.5)
    axes.set_xlabel(f"area under the curve, {look.label} minus {style(PLAIN).label}", fontsize=10)
    canvas.legend(loc="outside upper right", frameon=False, fontsize=10, ncols=2)
    save(canvas, path)


def _mark(axes: Axes, leads: Sequence[Estimate | None], below: float, colour: str, **look) -> None:
    rows = [row for row, lead in enumerate(leads) if lead]
    value, *ends = np.array([lead for lead in leads if lead]).reshape(-1, 3).T
    off, down = np.abs(ends - value), np.array(rows) + below
    axes.errorbar(value, down, xerr=off, fmt="o", color=colour, capsize=2, **look)


def _options(ours: Cell, theirs: Cell) -> str:
    """Unusual options that both have, or that SACfD alone has."""
    same = ours.variant == theirs.variant
    return theirs.variant if same else f"{style(PLAIN).label}: {theirs.variant}"
