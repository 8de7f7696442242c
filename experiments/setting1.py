"""Setting 1: from demonstrations of shape 0 to shapes 1 to 4, the hole where it was; all methods.

Hypothesis (Guo et al. 2022, figure 2): CRSfD is best on each shape; what imitates alone fails. The
first of the methods are done after 10,000 steps, hence evaluations twice as often as elsewhere; the
experiment early looks closer yet.
"""

from crsfd_jax.sweeps.grid import METHODS, axis, grid, methods

CELLS = grid(methods(*METHODS, every="5120"), axis("--shape", "1", "2", "3", "4"))
