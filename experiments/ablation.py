"""Ablation: CRSfD without regression to zero in free space, and without the larger discount.

Hypothesis (Guo et al. 2022, figure 4, on shape 3): both parts make it learn sooner. As often
evaluated as setting1.
"""

from crsfd_jax.sweeps.grid import axis, grid, methods

CELLS = grid(
    axis("--shape", "3", "1", "2", "4"),
    methods("crsfd", "crsfd_no_free_space", "crsfd_same_gamma", every="5120"),
)
