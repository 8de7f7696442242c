"""Where a run stands besides its states: counters, sums, and the rows they become."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from crsfd_jax.config import Config
from crsfd_jax.errors import UserError
from crsfd_jax.training import troubles


@dataclasses.dataclass
class Standing:
    """Everything in it is saved with the states, as JSON."""

    step: int = 0
    """Vector steps made."""
    wall_s: float = 0.0
    """Time spent in all sessions of the run."""
    sums: dict[str, list[float]] = dataclasses.field(default_factory=dict)
    """Training metrics added up since the last evaluation, a number for each seed."""
    success: list[float] = dataclasses.field(default_factory=list)
    """Newest success rate of each seed."""
    diverged: dict[str, int] = dataclasses.field(default_factory=dict)
    """Seed -> environment steps at which a number of it was first found not finite."""


def from_saved(values: Mapping[str, Any]) -> Standing:
    """The standing that was saved; what is younger than the checkpoint has its default.

    Raises:
      UserError: it holds something unknown.
    """
    unknown = values.keys() - {field.name for field in dataclasses.fields(Standing)}
    if unknown:
        raise UserError(
            f"checkpoint: holds {', '.join(sorted(unknown))}, unknown to this version; continue "
            "the run with the program version that wrote it"
        )
    return Standing(**values)


def add_up(at: Standing, values: Mapping[str, jax.Array]) -> None:
    """Adds the metrics [S] of a chunk."""
    for name, value in values.items():
        old = at.sums.get(name, [0.0] * len(value))
        at.sums[name] = [a + float(b) for a, b in zip(old, np.asarray(value), strict=True)]


def rows(config: Config, at: Standing, lengths: Sequence[float]) -> list[dict[str, float]]:
    """A row of metrics.csv for each seed, from the newest evaluation and the sums before it.

    What there was none of has no rate and no average: NaN.

    Args:
      lengths: mean episode length of each seed in the evaluation.
    """
    env_steps, made = at.step * config.envs, []
    for i in range(config.seeds):
        sums = {name: values[i] for name, values in at.sums.items()}
        episodes, successes = sums.pop("episodes", 0.0), sums.pop("successes", 0.0)
        nonfinite, learned = sums.pop("nonfinite", 0.0), sums.pop("learned", 0.0)
        limits = {name: sums.pop(name.removeprefix("env/"), math.nan) for name in troubles.LIMITS}
        made.append(
            {
                "env_steps": env_steps,
                "seed": config.seed + i,
                "eval/success_rate": at.success[i],
                "eval/episode_length": lengths[i],
                "eval/episodes": config.evaluation.episodes,
                "train/success_rate": _share(successes, episodes),
                "train/episodes": episodes,
                "train/diverged": float(str(config.seed + i) in at.diverged),
                "env/nonfinite": nonfinite,
                **limits,
                **{f"train/{name}": _share(value, learned) for name, value in sums.items()},
                "time/wall_s": at.wall_s,
                "time/env_steps_per_second": env_steps * config.seeds / max(at.wall_s, 1e-9),
            }
        )
    return made


def _share(value: float, whole: float) -> float:
    return value / whole if whole else math.nan
