"""Setting 2: shapes 0 and 2, the hole moved within squares of 4, 6 and 8 mm; CRSfD and SACfD.

Hypothesis (Guo et al. 2022, figure 3): equal on shape 0 with 4 mm, and the further from the
demonstrated task, the more CRSfD is ahead. Five seeds where the paper has three; five more, and
CRSfD with the potential of the nominal place alone, and both with a larger discount, where the
task is furthest away.
"""

from crsfd_jax.sweeps.grid import axis, grid, methods

FURTHEST = axis("--shift", "8mm"), axis("--shape", "2")
CELLS = (
    *grid(
        axis("--shift", "8mm", "4mm", "6mm"), axis("--shape", "2", "0"), methods("crsfd", "sacfd")
    ),
    *grid(*FURTHEST, methods("crsfd", "sacfd"), axis("--seed", "5")),
    *grid(*FURTHEST, methods("crsfd"), axis("--potential.spread", "0mm")),
    *grid(*FURTHEST, methods("crsfd", "sacfd"), axis("--sac.gamma", "0.99")),
)
