"""Setting 2 with all methods: shape 2, the hole moved within a square of 8 mm.

Hypothesis (Guo et al. 2022, appendix): CRSfD is best, SACfD second, the others hardly insert. Five
seeds left open whether RS-GM, GAIL and POfD are behind CRSfD: these have five more, a number set
before they were run.
"""

from crsfd_jax.sweeps.grid import METHODS, axis, grid, methods

TASK = axis("--shape", "2"), axis("--shift", "8mm")
CELLS = (
    *grid(methods(*METHODS), *TASK),
    *grid(methods("rsgm", "gail", "pofd"), *TASK, axis("--seed", "5")),
)
