"""Setting 1 and the ablation in their first 60,000 steps, where the methods that learn differ.

Hypothesis: CRSfD, SACfD and RLPD all end near 1.00 well within this budget, a fifth of the paper's;
what tells them apart is how soon. The order of the cells is that of what they tell. Five more
seeds on shape 3, where SQIL and CRSfD without the larger discount came closest.
"""

from crsfd_jax.sweeps.grid import axis, grid

REST = "1", "4", "2"
LEARNING = axis("--algorithm", "crsfd", "sacfd")
ARMS = axis("--algorithm", "crsfd_no_free_space", "crsfd_same_gamma")
OTHERS = axis("--algorithm", "bc", "sac", "sqil", "rlpd", "rsgm", "pofd", "gail", "gaifo")
CLOSEST = "crsfd", "sqil", "crsfd_same_gamma"
CELLS = (
    *grid(axis("--shape", "3"), (*LEARNING, *ARMS)),
    *grid(axis("--shape", "1", "4"), LEARNING),
    *grid(axis("--shape", "3"), OTHERS),
    *grid(axis("--shape", "2"), LEARNING),
    *grid(axis("--shape", "3"), axis("--algorithm", *CLOSEST), axis("--seed", "5")),
    *grid(axis("--shape", *REST), ARMS),
    *grid(OTHERS, axis("--shape", *REST)),
)
