"""Draws success against environment steps, panel by panel, as in the paper."""

import textwrap
from pathlib import Path

import matplotlib.figure
import matplotlib.lines
import numpy as np
from matplotlib.axes import Axes

from crsfd_jax.curve import Curve
from crsfd_jax.drawing.axes import band, clean
from crsfd_jax.report.cells import Cell
from crsfd_jax.report.layout import Figure
from crsfd_jax.report.methods import WITHOUT_INTERACTION, Style, rank, style
from crsfd_jax.storage.files import write_atomically

DPI = 192
"""Twice that of a page, for sharp screens and print."""
_TITLE_WIDTH = 38
"""Letters of a title that fit above a panel."""


def draw(figure: Figure, path: Path) -> None:
    """Writes a figure as PNG, all or nothing."""
    looks = _looks(figure)
    rows = -(-len(figure.panels) // figure.columns)
    longest = max(len(look.label) for look in looks.values())
    # Few panels leave no room below them for a legend of many entries.
    beside = 0.7 + 0.08 * longest if figure.columns < 3 else 0
    width, height = (4.6, 3.6) if len(figure.panels) == 1 else (3.3, 2.6)
    size = (width * figure.columns + 0.5 + beside, height * rows + (0.5 if beside else 0.9))
    canvas = matplotlib.figure.Figure(size, layout="constrained")
    grid = canvas.subplots(rows, figure.columns, sharex=True, sharey=True, squeeze=False)
    for axes, panel in zip(grid.flat, figure.panels, strict=False):
        _draw_panel(axes, panel.cells, looks)
        axes.set_title(textwrap.fill(panel.title, _TITLE_WIDTH), fontsize=10.5)
    for axes in grid.flat[len(figure.panels) :]:
        axes.set_visible(False)
    _label_edges(grid, len(figure.panels), figure.columns)
    across = 1 if beside else max(1, int(40 * figure.columns / (longest + 7)))
    _legend(canvas, looks, "outside right upper" if beside else "outside lower center", across)
    save(canvas, path)


def at_common_steps(curve: Curve) -> Curve:
    """The evaluations that all seeds had, or all if there are none.

    Of runs evaluated at other steps the mean would jump between their seeds.
    """
    rows = np.flatnonzero(np.isfinite(curve.values).all(axis=1))
    return Curve(curve.env_steps[rows], curve.values[rows]) if rows.size else curve


def save(canvas: matplotlib.figure.Figure, path: Path) -> None:
    """Writes a drawing as PNG, all or nothing."""
    write_atomically(path, lambda stream: canvas.savefig(stream, format="png", dpi=DPI))


def _looks(figure: Figure) -> dict[tuple[str, str], Style]:
    """Look of each method and variant of a figure, in the order of the legend.

    Whose runs are all shorter than those of others is labelled with how long they are.
    """
    found: dict[tuple[str, str], int] = {}
    for cell in (cell for panel in figure.panels for cell in panel.cells):
        key = cell.method, cell.variant
        found[key] = max(found.get(key, 0), cell.planned_steps)
    most = max((n for key, n in found.items() if key[0] not in WITHOUT_INTERACTION), default=0)
    looks, variants = {}, {}
    for method, variant in sorted(found, key=lambda key: (rank(key[0]), key[1])):
        number = variants[method] = variants.get(method, -1) + 1 if variant else 0
        look, steps = style(method, number), found[method, variant]
        if method in WITHOUT_INTERACTION:
            length = "no steps"
        else:
            length = f"{steps / 1000:g}k steps" * (steps < most)
        words = ", ".join(filter(None, (look.label, length, variant)))
        looks[method, variant] = look._replace(label=words)
    return looks


def _draw_panel(axes: Axes, cells: tuple[Cell, ...], looks: dict[tuple[str, str], Style]) -> None:
    clean(axes)
    axes.set_ylim(-0.03, 1.03)
    axes.set_yticks(np.linspace(0, 1, 6))
    for cell in reversed(cells):
        look = looks[cell.method, cell.variant]
        (_draw_cell if cell.interacts else _draw_level)(axes, cell, look)
    if not cells:
        axes.text(0.5, 0.5, "no run", transform=axes.transAxes, ha="center", color="0.55")


def _draw_cell(axes: Axes, cell: Cell, look: Style) -> None:
    curve = at_common_steps(cell.curve)
    thousands = curve.env_steps / 1000
    # Thin lines are many: their bands are paler.
    mean = band(axes, thousands, curve.values, look.colour, 0.05 * look.width)
    (line,) = axes.plot(thousands, mean, marker="o" if len(mean) == 1 else None)
    line.set(color=look.colour, linestyle=look.dashes, linewidth=look.width)


def _draw_level(axes: Axes, cell: Cell, look: Style) -> None:
    level = cell.curve.values[-1].mean()
    axes.axhline(level, color=look.colour, linestyle=look.dashes, linewidth=look.width)


def _label_edges(grid: np.ndarray, panels: int, columns: int) -> None:
    for axes in grid[:, 0]:
        axes.set_ylabel("success rate", fontsize=10)
    for index, axes in enumerate(grid.flat[:panels]):
        axes.set_xlim(left=0)
        if index + columns >= panels:
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("environment steps, thousands", fontsize=10)


def _legend(canvas, looks: dict[tuple[str, str], Style], place: str, across: int) -> None:
    lines = [
        matplotlib.lines.Line2D(
            [], [], color=look.colour, linestyle=look.dashes, linewidth=look.width, label=look.label
        )
        for look in looks.values()
    ]
    columns = min(across, len(lines))
    style = dict(frameon=False, fontsize=10, handlelength=2.6)
    canvas.legend(handles=lines, loc=place, ncols=columns, **style)
