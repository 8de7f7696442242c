"""What of CRSfD does it, its potential or the demonstrations in its buffer? Without the latter.

Hypothesis: without a shift the potential alone learns later than with demonstrations, and still
learns, where SAC does not; with 8 mm, where the demonstrations lack the search, they hardly matter.
The whole method, SACfD and SAC are in the experiments early, setting2 and setting2_wide.
"""

from crsfd_jax.sweeps.grid import axis, grid, methods

POTENTIAL = "crsfd_potential_only"
CELLS = (
    *grid(axis("--algorithm", POTENTIAL), axis("--shape", "1", "2", "3", "4")),
    *grid(methods(POTENTIAL), (("--shape", "2", "--shift", "8mm"),)),
)
