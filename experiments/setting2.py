"""Setting 2: shapes 0 and 2, the hole moved within squares of 4, 6 and 8 mm; CRSfD and SACfD.

Hypothesis (Guo et al. 2022, figure 3): equal on shape 0 with 4 mm, and the further from the
demonstrated task, the more CRSfD is ahead. Five seeds where the paper has three, and twenty with
8 mm: fifteen more on each shape, a number set before they were run, since five (ten on shape 2)
had left the order open. Where the task is furthest away, also CRSfD with the potential of the
nominal place alone, and both with a larger discount.
"""

from crsfd_jax.sweeps.grid import axis, grid, methods

FURTHEST = axis("--shift", "8mm"), axis("--shape", "2")
CELLS = (
    *grid(
        axis("--shift", "8mm", "4mm", "6mm"), axis("--shape", "2", "0"), methods("crsfd", "sacfd")
    ),
    *grid(
        axis("--shift", "8mm"),
        axis("--shape", "2", "0"),
        methods("crsfd", "sacfd"),
        axis("--seed", "5", "10", "15"),
    ),
    *grid(*FURTHEST, methods("crsfd"), axis("--potential.spread", "0mm")),
    *grid(*FURTHEST, methods("crsfd", "sacfd"), axis("--sac.gamma", "0.99")),
)
