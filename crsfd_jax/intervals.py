"""Confidence intervals of success rates."""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit

Z_95 = 1.959963984540054
"""The 0.975 quantile of the standard normal distribution."""


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a success rate, honest also near 0 and 1 and for few trials.

    Raises:
      ValueError: not 0 <= successes <= trials, or no trial.

    Source: Wilson 1927; Brown, Cai, DasGupta 2001, equation 4.
    """
    if trials < 1 or not 0 <= successes <= trials:
        raise ValueError(f"got {successes} successes in {trials} trials, allowed: 0 to trials >= 1")
    rate, z2 = successes / trials, Z_95**2
    centre = (successes + z2 / 2) / (trials + z2)
    half = Z_95 / (trials + z2) * math.sqrt(trials * rate * (1 - rate) + z2 / 4)
    return max(0.0, centre - half), min(1.0, centre + half)


def rate_interval(successes: ArrayLike, trials: ArrayLike) -> tuple[float, float]:
    """95 % interval of the success rate of the policies of several seeds.

    Its ends are the outer ones of Wilson's interval of all trials and of Student's t interval of
    the rates of the seeds: trials are few, and policies differ.

    Args:
      successes, trials: [S] of each seed; seeds without trials do not count.
    """
    trials, successes = np.asarray(trials), np.asarray(successes)
    low, high = wilson_interval(int(successes.sum()), int(trials.sum()))
    rates = successes[trials > 0] / trials[trials > 0]
    count = len(rates)
    if count > 1:
        half = float(stdtrit(count - 1, 0.975)) * rates.std(ddof=1) / math.sqrt(count)
        low, high = min(low, rates.mean() - half), max(high, rates.mean() + half)
    return float(max(0.0, low)), float(min(1.0, high))
