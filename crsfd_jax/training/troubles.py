"""Troubles of a run's simulations, as metrics.csv counts them, in words."""

from collections.abc import Mapping

import numpy as np

LIMITS = {
    "env/contact_limit": "contacts filled their room",
    "env/solver_limit": "the solver used up its iterations",
}
"""Columns that count control steps since the evaluation before; NaN where the engine tells not."""
_COUNTS = {"env/nonfinite": "the simulation broke down", **LIMITS}
USUAL = {"env/solver_limit": 0.1}
"""Share of the control steps up to which a count is not worth a word: contact is hard to solve."""


def words(table: Mapping[str, np.ndarray]) -> str:
    """What happened in how many control steps of the run; empty where nothing unusual did.

    Args:
      table: columns of metrics.csv, also of a version that did not count yet.
    """
    steps = sum(table["env_steps"][table["seed"] == seed].max() for seed in set(table["seed"]))
    counts = {said: np.nansum(table[name]) for name, said in _COUNTS.items() if name in table}
    usual = {_COUNTS[name]: share * steps for name, share in USUAL.items()}
    met = [f"{said} in {n:,.0f}" for said, n in counts.items() if n > usual.get(said, 0)]
    return f"{', '.join(met)} of {steps:,} control steps" if met else ""


def diverged(table: Mapping[str, np.ndarray]) -> list[str]:
    """A line for each seed that diverged, with the step at which that was found."""
    if "train/diverged" not in table:
        return []
    hit = table["train/diverged"] == 1
    seeds, steps = table["seed"][hit], table["env_steps"][hit]
    return [f"seed {s} diverged at {steps[seeds == s].min():,} steps" for s in sorted(set(seeds))]
