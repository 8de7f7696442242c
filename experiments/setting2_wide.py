"""Setting 2 with all methods: shape 2, the hole moved within a square of 8 mm.

Hypothesis (Guo et al. 2022, appendix): CRSfD is best, SACfD second, the others hardly insert.
"""

from crsfd_jax.sweeps.grid import METHODS, axis, grid, methods

CELLS = grid(methods(*METHODS), axis("--shape", "2"), axis("--shift", "8mm"))
