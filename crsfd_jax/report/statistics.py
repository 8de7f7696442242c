"""Numbers that compare runs: areas, trimmed means, and their intervals over seeds.

Means and differences have Student's t interval: of five seeds a percentile bootstrap covers the
mean in 85 % of the cases, not in 95 %. Interquartile means and chances of improvement, which have
no such form, are bootstrapped as Agarwal et al. 2021 (arXiv 2108.13264) advise, always from the
same seed, so that equal runs give equal numbers.

A seed starts from the same networks and the same draws on every task, so its scores on several
tasks are no independent ones: all intervals take the seeds, not the runs, as what was sampled.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

RESAMPLES = 10_000
LAST_SHARE = 0.1
"""The final success is the mean over the evaluations in this last share of the steps."""
IN_A_ROW = 3
"""Evaluations at a level after which a task counts as learned: one alone may be luck."""
_SEED = 0


class Estimate(NamedTuple):
    """A number and the ends of its 95 % interval."""

    value: float
    low: float
    high: float


def final(env_steps: np.ndarray, values: np.ndarray) -> np.ndarray:
    """[S] mean of the evaluations of each seed in the last tenth of its steps.

    Args:
      env_steps: [T] ascending.
      values: [T, S] with NaN where a seed has no evaluation; without any, the result is NaN.
    """
    return np.array([_final(*_known(env_steps, seed)) for seed in values.T])


def area(env_steps: np.ndarray, values: np.ndarray) -> np.ndarray:
    """[S] area under the curve of each seed over its steps: 1 is success from the start.

    Trapezoids from 0 steps, where success is 0 unless it was measured there; arguments as in
    `final`.
    """
    return np.array([_area(*_known(env_steps, seed)) for seed in values.T])


def settled_at(env_steps: np.ndarray, values: np.ndarray, level: float) -> float:
    """Steps [T] at the first of IN_A_ROW values [T] that all reach a level; infinite if none is.

    Of fewer values, all must reach it; NaN, where there was no evaluation, is passed over.
    """
    env_steps, values = _known(env_steps, values)
    reached = values >= level
    row = max(1, min(IN_A_ROW, len(reached)))
    starts = [i for i in range(len(reached) - row + 1) if reached[i : i + row].all()]
    return float(env_steps[starts[0]]) if starts else np.inf


def interquartile_mean(scores: np.ndarray) -> np.ndarray:
    """[...] mean of scores [..., N] without the lowest and highest quarter, N / 4 rounded down."""
    cut = scores.shape[-1] // 4
    return np.sort(scores, axis=-1)[..., cut : scores.shape[-1] - cut].mean(axis=-1)


def interquartile_interval(tasks: Sequence[np.ndarray]) -> Estimate:
    """Interquartile mean of the scores [S] of the runs of each task, all tasks taken together."""
    drawn = np.concatenate([scores[rows] for scores, rows in _resampled(tasks)], axis=1)
    return _estimate(interquartile_mean(np.concatenate(tasks)), interquartile_mean(drawn))


def weighted_interval(
    tasks: Sequence[np.ndarray], seeds: Sequence[np.ndarray], weights: Sequence[float]
) -> Estimate:
    """Sum of weight times mean score over tasks, with its t interval.

    The variance is that of sums over the tasks of each seed (cluster-robust), its degrees of
    freedom those of the task with the fewest seeds. One seed says nothing of the interval.

    Args:
      tasks: [S] scores on each task; of paired scores, the differences.
      seeds: [S] whose scores they are.
    """
    parts: dict[int, float] = {}
    for scores, names, weight in zip(tasks, seeds, weights, strict=True):
        for name, deviation in zip(names.tolist(), scores - scores.mean(), strict=True):
            parts[name] = parts.get(name, 0.0) + weight * deviation / len(scores)
    value = float(sum(w * scores.mean() for w, scores in zip(weights, tasks, strict=True)))
    fewest = min(map(len, tasks))
    if fewest < 2:
        return Estimate(value, -np.inf, np.inf)
    error = np.sqrt(fewest / (fewest - 1) * np.sum(np.square([*parts.values()])))
    half = float(stdtrit(fewest - 1, 0.975) * error)
    return Estimate(value, value - half, value + half)


def mean_interval(tasks: Sequence[np.ndarray], seeds: Sequence[np.ndarray]) -> Estimate:
    """Mean over tasks of the mean of the scores of each; tasks weigh the same."""
    return weighted_interval(tasks, seeds, [1 / len(tasks)] * len(tasks))


def improvement(ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray]) -> Estimate:
    """Chance that a run of ours scores above one of theirs on the same task, mean over tasks.

    Ties count half: on each task it is the U of Mann and Whitney over the number of pairs. Seeds of
    both are resampled.
    """
    values, drawn = [], []
    for x, y in zip(ours, theirs, strict=True):
        # Anew for each task: the same seeds are drawn on all.
        generator = np.random.default_rng(_SEED)
        won = (x[:, None] > y) + 0.5 * (x[:, None] == y)
        # How often each run is drawn says all: no [resamples, S, S] is needed.
        x_share, y_share = (_shares(generator, len(scores)) for scores in (x, y))
        values.append(won.mean())
        drawn.append(((x_share @ won) * y_share).sum(axis=1))
    return _estimate(np.mean(values), np.mean(drawn, axis=0))


def _final(env_steps: np.ndarray, values: np.ndarray) -> float:
    if not len(values):
        return np.nan
    is_last = env_steps >= (1 - LAST_SHARE) * env_steps[-1]
    return values[is_last].mean()


def _area(env_steps: np.ndarray, values: np.ndarray) -> float:
    if not len(values) or env_steps[-1] == 0:
        return values[-1] if len(values) else np.nan
    if env_steps[0] > 0:
        env_steps, values = np.append(0, env_steps), np.append(0.0, values)
    return np.trapezoid(values, env_steps) / env_steps[-1]


def _known(env_steps: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    known = np.isfinite(values)
    return env_steps[known], values[known]


def _resampled(tasks: Sequence[np.ndarray]):
    """Scores [S] and rows [RESAMPLES, S] drawn from them with replacement, alike on all tasks."""
    for scores in tasks:
        generator = np.random.default_rng(_SEED)
        yield scores, generator.integers(len(scores), size=(RESAMPLES, len(scores)))


def _shares(generator: np.random.Generator, count: int) -> np.ndarray:
    """[RESAMPLES, count] how much of a resample each run makes up."""
    return generator.multinomial(count, np.full(count, 1 / count), size=RESAMPLES) / count


def _estimate(value, drawn: np.ndarray) -> Estimate:
    low, high = np.percentile(drawn, (2.5, 97.5))
    return Estimate(float(value), float(low), float(high))
