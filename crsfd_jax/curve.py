"""A learning curve: one metric of all seeds against environment steps."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np


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


def mean_and_std(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
