"""Learning curves of one or more runs as a picture."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crsfd_jax import metrics
from crsfd_jax.errors import UserError
from crsfd_jax.files import write_atomically

# Okabe and Ito 2008: told apart by colour-blind readers too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
PANELS = {
    "eval/success_rate": "evaluation, deterministic policy",
    "train/success_rate": "training episodes, with exploration",
}


class Curve(NamedTuple):
    """One metric of one run."""

    env_steps: np.ndarray
    """[T] steps at which at least one seed was evaluated, ascending."""
    values: np.ndarray
    """[T, S] one column a seed; NaN where it has no row."""


def curve(columns: Mapping[str, np.ndarray], name: str) -> Curve:
    """Arranges a column of metrics.csv by step and seed."""
    steps, row = np.unique(columns["env_steps"], return_inverse=True)
    seeds, column = np.unique(columns["seed"], return_inverse=True)
    values = np.full((len(steps), len(seeds)), np.nan)
    values[row, column] = columns[name]
    return Curve(steps, values)


def plot(runs: Mapping[str, Path], picture: Path) -> None:
    """Draws success against environment steps: mean, spread and single seeds.

    Args:
      runs: label -> metrics.csv.
      picture: the .png to write, all or nothing.

    Raises:
      UserError: a run has no metrics yet.
    """
    tables = {label: metrics.read(path) for label, path in runs.items()}
    for label, table in tables.items():
        if not len(table["env_steps"]):
            raise UserError(f"{runs[label]}: holds no evaluation yet; train for longer")
    panels = [name for name in PANELS if any(name in table for table in tables.values())]
    if not panels:
        raise UserError(f"{', '.join(tables)}: none of {', '.join(PANELS)} in metrics.csv")
    figure = Figure(figsize=(5.2 * len(panels), 3.6), layout="constrained")
    for axes, name in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        for index, (label, table) in enumerate(tables.items()):
            if name in table:
                _draw_curve(axes, curve(table, name), label, COLOURS[index % len(COLOURS)])
        _finish(axes, PANELS[name])
    _add_legend(figure, len(tables))
    picture.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(picture, lambda stream: figure.savefig(stream, format="png", dpi=160))


def mean_and_spread(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation over the seeds that have a value.

    Args:
      values: [T, S] with NaN where a seed has no value.

    Returns:
      [T] and [T], NaN where no seed has a value.
    """
    known = np.isfinite(values)
    count = np.where(known.any(axis=1), known.sum(axis=1), np.nan)
    mean = np.where(known, values, 0).sum(axis=1) / count
    deviation = np.where(known, values - mean[:, None], 0)
    return mean, np.sqrt((deviation**2).sum(axis=1) / count)


def _draw_curve(axes: Axes, data: Curve, label: str, colour: str) -> None:
    thousands = data.env_steps / 1000
    mean, spread = mean_and_spread(data.values)
    low, high = np.clip(mean - spread, 0, 1), np.clip(mean + spread, 0, 1)
    for seed in data.values.T:
        known = np.isfinite(seed)
        axes.plot(thousands[known], seed[known], color=colour, linewidth=0.7, alpha=0.35)
    axes.fill_between(thousands, low, high, color=colour, alpha=0.15, linewidth=0)
    marker = "o" if len(thousands) == 1 else None
    seeds = data.values.shape[1]
    name = f"{label} ({seeds} seed{'s' * (seeds > 1)})"
    axes.plot(thousands, mean, color=colour, linewidth=2, marker=marker, label=name)


def _finish(axes: Axes, title: str) -> None:
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel("environment steps of each seed, thousands")
    axes.set_ylabel("success rate")
    axes.set_ylim(-0.03, 1.03)
    axes.set_xlim(left=0)
    axes.grid(color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _add_legend(figure: Figure, runs: int) -> None:
    entries = {}
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    figure.legend(
        entries.values(),
        entries.keys(),
        loc="outside lower center",
        ncols=min(runs, 3),
        frameon=False,
        fontsize=9,
        title="line: mean, band: one standard deviation, thin: single seeds",
        title_fontsize=8,
    )
