"""Sensitivity: one choice at a time, on shape 2 with the hole moved within a square of 8 mm.

CRSfD for its own parameters; with SACfD where the task or the demonstrations change. The
unchanged run comes first; it stands for gamma_0 0.95, gamma_k 0.98, lambda 0.1, 40
demonstrations, 1.5 times the expert's spread and 1 mm of clearance. Demonstrations of other
spread (at 3 the expert succeeds in a third of its episodes) are made before, a minute each:
    python -m crsfd_jax.demos record --noise 1 --out runs/demos/noise1.npz
    python -m crsfd_jax.demos record --noise 3 --out runs/demos/noise3.npz
"""

from crsfd_jax.sweeps.grid import axis, grid, methods

TASK = (("--shape", "2", "--shift", "8mm", "--seeds", "3"),)
OWN = (
    *axis("--potential.gamma", "0.9", "0.93", "0.97"),
    *axis("--sac.gamma", "0.96", "0.97", "0.99"),
    *axis("--potential.free-space-weight", "0", "0.01", "1"),
)
COMMON = (
    *axis("--demo-episodes", "1", "5", "10"),
    *axis("--scene.clearance", "2mm", "0.5mm", "0.3mm"),
    *axis("--demos", "runs/demos/noise1.npz", "runs/demos/noise3.npz"),
)
BOTH = methods("crsfd", "sacfd")
CELLS = (
    *grid(BOTH, TASK),
    *grid(methods("crsfd"), TASK, OWN),
    *grid(TASK, COMMON, BOTH),
)
