"""What of CRSfD does it, its potential or the demonstrations in its batches? One without the other.

Hypothesis: in place the potential alone learns later than with demonstrations, and still learns,
where SAC does not. The further the hole may have moved, the less demonstrations in the batches are
worth, since they lack the search. That was found on shape 2 with 8 mm, and is the default wherever
the hole may have moved; here is the other choice for each task. Where demonstrations are not in the
batches a run's warm-up imitates them, and finds its first holes so: here is what happens if it does
not, and whether it does as much for SACfD, with demonstrations in its batches and without, which is
CRSfD without its potential, and for GAIL, GAIfO and POfD, whose batches hold none. RS-GM, which is
CRSfD with another potential, has the other choice, too, and is run on shape 0. Two more: a
potential that is zero at success, so that it does not add to what a success pays, and a warm-up as
long as an episode, which meets more successes, where a seed met none. The default, SACfD and SAC
are in the experiments early, setting2 and setting2_wide. Seeds with 8 mm as there; after a warm-up
at random 0 to 14.
"""

from crsfd_jax.sweeps.grid import axis, grid, methods

NEW, OLD_AND_NEW = axis("--shape", "1", "2", "3", "4"), axis("--shape", "2", "0")
IN_PLACE = axis("--algorithm", "crsfd"), NEW
MOVED = methods("crsfd"), OLD_AND_NEW
SACFD = methods("sacfd"), OLD_AND_NEW
FAR = axis("--shift", "8mm")
ALONE, TOO = axis("--replay.draw-demos", "no"), axis("--replay.draw-demos", "yes")
RANDOM, BY_DEMOS = axis("--sac.warmup", "random"), axis("--sac.warmup", "demos")
IMITATORS = axis("--algorithm", "gail", "pofd", "gaifo")
ZERO_AT_SUCCESS = methods("crsfd"), axis("--shape", "2"), FAR, axis("--potential.terminal", "zero")
LONGER = axis("--shape", "0"), FAR, axis("--seed", "5"), axis("--sac.warmup-steps", "3200")
CELLS = (
    *grid(*IN_PLACE, ALONE),
    *grid(*IN_PLACE, ALONE, RANDOM),
    *grid(*MOVED, axis("--shift", "4mm", "6mm"), TOO),
    *grid(methods("crsfd"), axis("--shape", "2"), axis("--shift", "6mm"), RANDOM),
    *grid(*MOVED, FAR, TOO),
    *grid(*MOVED, FAR, TOO, axis("--seed", "5", "10", "15")),
    *grid(*MOVED, FAR, RANDOM),
    *grid(*MOVED, FAR, RANDOM, axis("--seed", "5", "10")),
    *grid(methods("crsfd"), axis("--shape", "all"), FAR, RANDOM),
    *grid(*SACFD, FAR, BY_DEMOS),
    *grid(axis("--algorithm", "sacfd"), NEW, ALONE),
    *grid(*SACFD, FAR, ALONE),
    *grid(*SACFD, FAR, ALONE, axis("--seed", "5", "10", "15")),
    *grid(*ZERO_AT_SUCCESS),
    *grid(*ZERO_AT_SUCCESS, axis("--seed", "5", "10", "15")),
    *grid(methods("rsgm"), axis("--shape", "2"), FAR, TOO),
    *grid(methods("rsgm"), axis("--shape", "0"), FAR),
    *grid(IMITATORS, NEW, RANDOM),
    *grid(methods("gail", "pofd", "gaifo"), axis("--shape", "2"), FAR, RANDOM),
    *grid(methods("crsfd"), *LONGER),
    *grid(methods("sacfd"), ALONE, *LONGER),
)
