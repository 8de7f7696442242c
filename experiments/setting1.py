"""Setting 1: from demonstrations of shape 0 to shapes 1 to 4, the hole where it was; all methods.

Hypothesis (Guo et al. 2022, figure 2): CRSfD is best on each shape; what imitates alone fails.
"""

from crsfd_jax.sweeps.grid import METHODS, axis, grid, methods

CELLS = grid(methods(*METHODS), axis("--shape", "1", "2", "3", "4"))
