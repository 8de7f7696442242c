"""A learned task teaches the next: demonstrations of a policy that searches, shape 2 with 8 mm.

Hypothesis: demonstrations recorded with a moved hole hold the search for it, which those of the
nominal place do not, so both methods learn sooner. Their positions are spread over the places of
the hole already, so the potential is fitted to them as they are, and CRSfD draws them into its
batches. BC says how much of the new task the demonstrations solve by themselves.

They are recorded from a run of setting 2, which must be there:
    python -m crsfd_jax.sweep --experiment setting2 --only crsfd-shape0-shift8mm-seed0x5
"""

from crsfd_jax.sweeps.grid import axis, grid, methods

DEMOS = {
    "runs/demos/search.npz": ("from-run", "runs/setting2/crsfd-shape0-shift8mm-seed0x5"),
}
TASK = (("--shape", "2", "--shift", "8mm"),)
CELLS = grid(methods("crsfd", "sacfd", "bc"), TASK, axis("--demos", *DEMOS))
