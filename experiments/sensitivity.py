"""When does shaping help? One choice at a time on shape 2, its hole in place or moved.

Hypothesis: the fewer or the worse demonstrations there are, the less SACfD gets from its batches,
while the potential that CRSfD fits to them is felt in every one; so its lead grows. Its own
parameters matter less than the demonstrations do. A hole turned by up to 0.05 rad, twice what the
clearance forgives, costs both methods alike. With the hole moved within a square of 4 mm the way
down is a small part of the work, and every lead is smaller.

CRSfD and SACfD where the task, the discount or the demonstrations change, CRSfD alone for its own
parameters. The unchanged run without a shift is in the experiment early; it stands for gamma_0
0.95, gamma_k 0.98, lambda 0.1, 40 demonstrations, 1.5 times the expert's spread and 1 mm of
clearance. Cells with a moved hole, where CRSfD draws no demonstrations into its batches, have twice
the steps and their own unchanged run.
"""

from crsfd_jax.sweeps.grid import axis, grid

DEMOS = {
    "runs/demos/noise3.npz": ("record", "--noise", "3"),
    "runs/demos/noise1.npz": ("record", "--noise", "1"),
    "runs/demos/expert1.npz": ("record", "--seed", "1"),
}
MOVED = (("--shift", "4mm", "--steps", "80000", "--evaluation.every", "4096"),)
UNCHANGED = ((),)
COMMON = (
    *axis("--demo-episodes", "1", "5", "10"),
    *axis("--scene.clearance", "0.3mm", "0.5mm", "2mm"),
    ("--randomisation.socket-yaw", "-0.05", "0.05"),
    *axis("--demos", *DEMOS),
    *axis("--sac.gamma", "0.96", "0.97", "0.99"),
)
OWN = (
    *axis("--potential.gamma", "0.9", "0.93", "0.97"),
    *axis("--potential.free-space-weight", "0.01", "1"),
)
OF_PLACE = (
    *axis("--potential.spread", "0mm"),
    *axis("--potential.terminal", "zero"),
)
"""In place the first changes nothing, and the second is in the experiment reward_scale."""
BOTH = axis("--algorithm", "crsfd", "sacfd")
CRSFD = axis("--algorithm", "crsfd")
CELLS = (
    *grid(COMMON, BOTH),
    *grid(OWN, CRSFD),
    *grid(MOVED, UNCHANGED + COMMON, BOTH),
    *grid(MOVED, OWN + OF_PLACE, CRSFD),
)
