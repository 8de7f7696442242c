"""Limits of the physics engine that a run met, as metrics.csv counts them, in words."""

from collections.abc import Mapping

import numpy as np

COUNTS = {
    "env/contact_limit": "contacts filled their room",
    "env/solver_limit": "the solver used up its iterations",
}
"""Columns that count control steps since the evaluation before; NaN where nobody tells."""


def words(table: Mapping[str, np.ndarray]) -> str:
    """What was met in how many control steps of the run; empty where nothing was.

    Args:
      table: columns of metrics.csv, also of a version that did not count yet.
    """
    steps = sum(table["env_steps"][table["seed"] == seed].max() for seed in set(table["seed"]))
    counts = {said: np.nansum(table[name]) for name, said in COUNTS.items() if name in table}
    met = [f"{said} in {count:,.0f}" for said, count in counts.items() if count]
    return f"{', '.join(met)} of {steps:,} control steps" if met else ""
