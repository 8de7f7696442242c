"""Transfer: training under what a real arm adds, for trials under errors that it never met.

Hypothesis (Guo et al. 2022, table 1: 1.0, 1.0, 0.92, 0.92, 0.96 for shapes 0 to 4): a policy
trained with errors also inserts under larger ones, and one trained without does so less often.

Each of the 5 policies of a run has 100 trials.
"""

from crsfd_jax.sweeps.grid import axis, grid, methods

TASK = axis("--shift", "2mm")
SHAPES = axis("--shape", "0", "1", "2", "3", "4")
WITH_ERRORS = (
    (
        *("--randomisation.friction", "1", "2"),
        *("--randomisation.stiffness", "0.9", "1.1"),
        *("--randomisation.damping", "0.8", "1.2"),
        *("--randomisation.delay", "0.5"),
        *("--randomisation.encoder-offset", "-0.001", "-0.0007", "-0.0004"),
        *("0.0004", "0.0007", "0.001"),
        *("--randomisation.position-noise", "0.2mm"),
        *("--randomisation.rotation-noise", "0.001"),
    ),
)
TRIALS = ("--held-out", "--episodes", "100")
CELLS = (
    *grid(methods("crsfd"), TASK, WITH_ERRORS, SHAPES),
    *grid(methods("crsfd"), TASK, SHAPES),
    *grid(methods("sacfd"), TASK, WITH_ERRORS, SHAPES),
)
