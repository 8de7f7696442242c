"""Shape 2, socket offset drawn in an 8 x 8 mm square: CRSfD, SACfD and SAC on the same budget.

Hypothesis (Guo et al. 2022, setting 2): with demonstrations of shape 0 without a shift, CRSfD
learns the shifted task with fewer steps than SACfD; SAC without demonstrations does not learn it.

Commands, for ALGORITHM in crsfd, sacfd, sac:
    python -m crsfd_jax.train --shape 2 --shift 8mm --steps 300000 --evaluation.every 10240 \
        --algorithm ALGORITHM --out runs/shape2_shift8mm_ALGORITHM
and copy metrics.csv of each to experiments/results/. This file draws the figure and the table.
"""

from pathlib import Path

import numpy as np

from crsfd_jax import metrics
from crsfd_jax.report import curves

RESULTS = Path(__file__).parent / "results"
FIGURE = Path(__file__).parents[1] / "docs" / "shape2_shift8mm.png"


def main() -> None:
    """Draws the figure and prints a line for each method."""
    runs = {a: RESULTS / f"shape2_shift8mm_{a}.csv" for a in ("crsfd", "sacfd", "sac")}
    curves.plot(runs, FIGURE)
    for label, path in runs.items():
        curve = curves.curve(metrics.read(path), "eval/success_rate")
        area = curve.values.mean(axis=0)
        reached = curve.values.mean(axis=1) >= 0.9
        first = f"{curve.env_steps[reached.argmax()]}" if reached.any() else "never"
        print(
            f"{label:6s} final {curve.values[-1].mean():.3f}, area under the curve of each seed "
            f"{np.round(area, 3).tolist()}, mean {area.mean():.3f}; mean first at 0.9: {first}"
        )


if __name__ == "__main__":
    main()
