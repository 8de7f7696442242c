"""The learning curve of a run as a picture, made beside its metrics."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crsfd_jax.curve import Curve, curve
from crsfd_jax.drawing.axes import band, clean
from crsfd_jax.storage import metrics
from crsfd_jax.storage.files import write_atomically

PANELS = {
    "eval/success_rate": "evaluation, deterministic policy",
    "train/success_rate": "training episodes, with exploration",
}
_COLOUR = "#0072B2"


def plot(label: str, table: Path, picture: Path) -> None:
    """Draws success against environment steps: mean, standard deviation and single seeds.

    Args:
      table: metrics.csv with at least one evaluation.
      picture: the .png to write, all or nothing.
    """
    columns = metrics.read(table)
    figure = Figure(figsize=(5.2 * len(PANELS), 3.6), layout="constrained")
    for axes, (name, title) in zip(figure.subplots(1, len(PANELS)), PANELS.items(), strict=True):
        _draw(axes, curve(columns, name), label)
        axes.set(ylabel="success rate", ylim=(-0.03, 1.03), xlim=(0, None))
        axes.set_xlabel("environment steps of each seed, thousands")
        axes.set_title(title, fontsize=10, loc="left")
        clean(axes)
    figure.legend(
        *axes.get_legend_handles_labels(),
        loc="outside lower center",
        frameon=False,
        fontsize=9,
        title="line: mean, band: one standard deviation, thin: single seeds",
        title_fontsize=8,
    )
    write_atomically(picture, lambda stream: figure.savefig(stream, format="png", dpi=160))


def _draw(axes: Axes, found: Curve, label: str) -> None:
    thousands = found.env_steps / 1000
    for seed in found.values.T:
        known = np.isfinite(seed)
        axes.plot(thousands[known], seed[known], color=_COLOUR, linewidth=0.7, alpha=0.35)
    mean = band(axes, thousands, found.values, _COLOUR)
    marker, seeds = "o" if len(thousands) == 1 else None, found.values.shape[1]
    name = f"{label} ({seeds} seed{'s' * (seeds > 1)})"
    axes.plot(thousands, mean, color=_COLOUR, linewidth=2, marker=marker, label=name)
