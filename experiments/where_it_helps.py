"""Where shaping helps: fewer demonstrations and tighter holes, first 60,000 steps of shape 2.

Hypothesis: the fewer demonstrations there are, the less they weigh in SACfD's batches, while the
potential that CRSfD fits to them is felt in every one; so its lead grows.
"""

from crsfd_jax.sweeps.grid import axis, grid

CELLS = grid(
    (
        *axis("--demo-episodes", "1", "5", "10"),
        *axis("--scene.clearance", "0.5mm", "0.3mm"),
    ),
    axis("--algorithm", "crsfd", "sacfd"),
)
