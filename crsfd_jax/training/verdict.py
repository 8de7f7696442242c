"""What a finished run came to: its success, the seeds that count, whether that was enough."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from crsfd_jax.config import Config
from crsfd_jax.errors import DONE, MISSED
from crsfd_jax.intervals import rate_interval


class Verdict(NamedTuple):
    """The last line of a run and its exit code."""

    line: str
    code: int


def judge(
    config: Config, success: Sequence[float], diverged: Mapping[str, int], wall_s: float
) -> Verdict:
    """Sums a run up.

    Args:
      success: final rate of each seed.
      diverged: seed -> environment steps at which it was found diverged; it does not count, but
        has failed where there is a target.
    """
    seeds = [str(config.seed + i) for i in range(config.seeds)]
    counted = [rate for seed, rate in zip(seeds, success, strict=True) if seed not in diverged]
    lost = ", ".join(f"seed {seed} diverged at {diverged[seed]:,} steps" for seed in diverged)
    if not counted:
        return Verdict(f"final success unknown: no seed counts ({lost}), {wall_s:.0f} s", MISSED)
    episodes = config.evaluation.episodes
    each = [round(rate * episodes) for rate in counted]
    trials, successes = episodes * len(counted), sum(each)
    low, high = rate_interval(each, [episodes] * len(each))
    who = f"{len(counted)} of {config.seeds} seeds, {lost}" if lost else f"{config.seeds} seeds"
    line = (
        f"final success {successes / trials:.3f}, 95 % interval {low:.3f} to {high:.3f} "
        f"({successes} of {trials} episodes, {who}), {wall_s:.0f} s"
    )
    if not config.target:
        return Verdict(line, DONE)
    missed = successes / (episodes * config.seeds) < config.target
    word = "missed" if missed else "reached"
    return Verdict(f"{line}, target {config.target:g} {word}", MISSED if missed else DONE)
