"""Numbers that compare runs: areas, trimmed means and bootstrap intervals over seeds.

Runs are resampled within their task and tasks are kept, as Agarwal et al. 2021 (arXiv 2108.13264)
advise for few runs. Every function that resamples starts from the same seed: equal runs give equal
numbers.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

RESAMPLES = 10_000
LAST_SHARE = 0.1
"""The final success is the mean over the evaluations in this last share of the steps."""
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


def first_at(env_steps: np.ndarray, values: np.ndarray, level: float) -> float:
    """Steps [T] at the first of the values [T] that reaches a level; infinite if none does."""
    reached = np.flatnonzero(values >= level)
    return float(env_steps[reached[0]]) if len(reached) else np.inf


def interquartile_mean(scores: np.ndarray) -> np.ndarray:
    """[...] mean of scores [..., N] without the lowest and highest quarter, N / 4 rounded down."""
    cut = scores.shape[-1] // 4
    return np.sort(scores, axis=-1)[..., cut : scores.shape[-1] - cut].mean(axis=-1)


def interquartile_interval(tasks: Sequence[np.ndarray]) -> Estimate:
    """Interquartile mean of the scores [S] of the runs of each task, all tasks taken together."""
    drawn = np.concatenate([scores[rows] for scores, rows in _resampled(tasks)], axis=1)
    return _estimate(interquartile_mean(np.concatenate(tasks)), interquartile_mean(drawn))


def mean_interval(tasks: Sequence[np.ndarray]) -> Estimate:
    """Mean over tasks of the mean of the scores [S] of each; tasks weigh the same.

    Of paired scores, give the differences.
    """
    drawn = [scores[rows].mean(axis=1) for scores, rows in _resampled(tasks)]
    return _estimate(np.mean([scores.mean() for scores in tasks]), np.mean(drawn, axis=0))


def gap_interval(larger: Sequence[np.ndarray], smaller: Sequence[np.ndarray]) -> Estimate:
    """How much larger the mean over tasks of one group is than that of another."""
    groups = _resampled([*larger, *smaller])
    drawn = np.array([scores[rows].mean(axis=1) for scores, rows in groups])
    value = np.mean([s.mean() for s in larger]) - np.mean([s.mean() for s in smaller])
    gaps = drawn[: len(larger)].mean(axis=0) - drawn[len(larger) :].mean(axis=0)
    return _estimate(value, gaps)


def improvement(ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray]) -> Estimate:
    """Chance that a run of ours scores above one of theirs on the same task, mean over tasks.

    Ties count half: on each task it is the U of Mann and Whitney over the number of pairs. Runs of
    both are resampled.
    """
    generator = np.random.default_rng(_SEED)
    values, drawn = [], []
    for x, y in zip(ours, theirs, strict=True):
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
    """Scores [S] and rows [RESAMPLES, S] drawn from them with replacement, task by task."""
    generator = np.random.default_rng(_SEED)
    return [(s, generator.integers(len(s), size=(RESAMPLES, len(s)))) for s in tasks]


def _shares(generator: np.random.Generator, count: int) -> np.ndarray:
    """[RESAMPLES, count] how much of a resample each run makes up."""
    return generator.multinomial(count, np.full(count, 1 / count), size=RESAMPLES) / count


def _estimate(value, drawn: np.ndarray) -> Estimate:
    low, high = np.percentile(drawn, (2.5, 97.5))
    return Estimate(float(value), float(low), float(high))
