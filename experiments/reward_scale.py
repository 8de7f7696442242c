"""How large should rewards be? CRSfD and SACfD on shape 2 under factors of 1 to 64.

Hypothesis: kept at success, the potential pays about as much as the success itself; a lead over
SACfD may come from that alone. Then SACfD with larger rewards catches up, and CRSfD whose
potential is zero at success is not ahead. The default is in the experiment early.

Or is it the entropy bonus, which is 16 times as much beside rewards times 1? Then these are learned
as soon with a sixteenth of its weight at the start.
"""

from crsfd_jax.sweeps.grid import axis, grid

FACTORS = axis("--sac.reward-scale", "1", "4", "32", "64")
COLDER = (("--sac.reward-scale", "1", "--sac.initial-alpha", "0.00125"),)
ZERO = axis("--potential.terminal", "zero")
CELLS = (
    *grid(axis("--shape", "2"), axis("--algorithm", "sacfd", "crsfd"), FACTORS),
    *grid(axis("--shape", "2"), axis("--algorithm", "crsfd"), ZERO),
    *grid(axis("--shape", "2"), axis("--algorithm", "sacfd", "crsfd"), COLDER),
)
