"""Setting 1 and the ablation in their first 40,000 steps, where the methods that learn differ.

Hypothesis: CRSfD, SACfD and RLPD all end near 1.00 well within this budget, a seventh of the
paper's; what tells them apart is how soon. The order of the cells is that of what they tell. SQIL
and RS-GM came closest to CRSfD, and five seeds left open which is ahead: so these three, and SACfD,
which CRSfD is made of, have five more. Ten left open whether SQIL on shape 3 is behind: on every
shape these two have ten more, a number set before they were run.
"""

from crsfd_jax.sweeps.grid import axis, grid

REST = "1", "4", "2"
LEARNING = axis("--algorithm", "crsfd", "sacfd")
ARMS = axis("--algorithm", "crsfd_no_free_space", "crsfd_same_gamma")
OTHERS = axis("--algorithm", "bc", "sac", "sqil", "rlpd", "rsgm", "pofd", "gail", "gaifo")
CLOSEST = axis("--algorithm", "sqil", "rsgm")
CELLS = (
    *grid(axis("--shape", "3"), (*LEARNING, *ARMS)),
    *grid(axis("--shape", "1", "4"), LEARNING),
    *grid(axis("--shape", "3"), OTHERS),
    *grid(axis("--shape", "2"), LEARNING),
    *grid(axis("--shape", *REST), ARMS),
    *grid(OTHERS, axis("--shape", *REST)),
    *grid(axis("--shape", "3", *REST), (*LEARNING, *CLOSEST), axis("--seed", "5")),
    *grid(
        axis("--shape", "3", *REST),
        axis("--algorithm", "crsfd", "sqil"),
        axis("--seed", "10", "15"),
    ),
)
