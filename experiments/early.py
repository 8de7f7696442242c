"""Setting 1 and the ablation in their first 60,000 steps, where the methods that learn differ.

Hypothesis: CRSfD, SACfD and RLPD all end near 1.00 well within this budget, a fifth of the paper's;
what tells them apart is how soon. The order of the cells is that of what they tell.
"""

from crsfd_jax.sweeps.grid import axis, grid

ALL = axis("--shape", "3", "1", "4", "2")
CELLS = (
    *grid(ALL, axis("--algorithm", "crsfd", "sacfd")),
    *grid(axis("--shape", "3"), axis("--algorithm", "crsfd_no_free_space", "crsfd_same_gamma")),
    *grid(axis("--algorithm", "bc", "sac", "sqil", "rlpd", "rsgm", "pofd", "gail", "gaifo"), ALL),
)
