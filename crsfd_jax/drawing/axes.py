"""What plots of this package have in common."""

import numpy as np
from matplotlib.axes import Axes

from crsfd_jax.curve import mean_and_std


def clean(axes: Axes) -> None:
    """Takes away what is not needed to read a plot."""
    axes.grid(color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)


def band(
    axes: Axes, thousands: np.ndarray, values: np.ndarray, colour: str, alpha: float = 0.14
) -> np.ndarray:
    """Shades one standard deviation of success rates [T, S] about their mean, which it returns."""
    mean, std = mean_and_std(values)
    low, high = np.clip(mean - std, 0, 1), np.clip(mean + std, 0, 1)
    axes.fill_between(thousands, low, high, color=colour, alpha=alpha, linewidth=0)
    return mean
