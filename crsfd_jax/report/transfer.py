"""Draws held-out trials, shape by shape, beside those of the paper on its arm."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib.figure
import numpy as np

from crsfd_jax.drawing.axes import clean
from crsfd_jax.intervals import wilson_interval
from crsfd_jax.options.randomisation import Randomisation
from crsfd_jax.report import paper
from crsfd_jax.report.figures import save
from crsfd_jax.report.methods import style
from crsfd_jax.report.trials import Trials

_APART = 0.16
"""Between the methods of a shape, of the distance between two shapes."""


def draw(found: Sequence[Trials], path: Path) -> None:
    """Writes a PNG: success rate and 95 % interval of each method on each shape.

    Beside them the paper's, of which the interval is Wilson's.

    Args:
      found: at least one.
    """
    shapes = sorted({each.shape for each in found})
    labels = list(dict.fromkeys(each.label for each in found))
    canvas = matplotlib.figure.Figure((1.0 * len(shapes) + 4.2, 3.0), layout="constrained")
    axes = canvas.subplots()
    clean(axes)
    for number, label in enumerate(labels):
        own = [each for each in found if each.label == label]
        place = [shapes.index(each.shape) for each in own]
        rate, *ends = np.array([each.rate for each in own]).T
        colour = style(own[0].cell.method).colour
        axes.errorbar(
            np.array(place) + _APART * (number - (len(labels) - 1) / 2),
            rate,
            np.abs(np.array(ends) - rate),
            fmt="o",
            color=colour,
            markerfacecolor=colour if own[0].drawn != Randomisation() else "white",
            capsize=2,
            label=label,
        )
    theirs = paper.SUCCESS
    known = [(place, theirs[shape]) for place, shape in enumerate(shapes) if shape in theirs]
    if known:
        place, rate = np.array(known).T
        ends = [wilson_interval(round(paper.TRIALS * r), paper.TRIALS) for r in rate.tolist()]
        off = np.abs(np.array(ends).T - rate)
        beside = np.array(place) - _APART * (len(labels) + 1) / 2
        axes.errorbar(
            beside,
            rate,
            off,
            fmt="_",
            markersize=14,
            color="0.45",
            capsize=2,
            zorder=1,
            label=paper.NAME,
        )
    axes.set_xticks(range(len(shapes)), shapes)
    axes.set_xlim(-0.5, len(shapes) - 0.5)
    axes.set_ylim(top=1.01)
    axes.set_xlabel("shape", fontsize=10)
    axes.set_ylabel("success rate", fontsize=10)
    canvas.legend(loc="outside right upper", frameon=False, fontsize=10)
    save(canvas, path)
