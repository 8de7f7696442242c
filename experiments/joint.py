"""One policy for all five shapes, shifts up to 8 mm, from the same demonstrations; and five.

Hypothesis: one policy reaches 0.9 in the mean over the shapes. Each of its episodes draws a
shape, so per shape it meets a fifth of the steps; each of the five separate policies has all. The
table of a policy's 500 trials says how each shape fares.
"""

from crsfd_jax.sweeps.grid import axis, grid, methods

TASK = axis("--shift", "8mm")
TRIALS = ("--episodes", "500")
CELLS = (
    *grid(methods("crsfd"), TASK, axis("--shape", "all", "0", "1", "2", "3", "4")),
    *grid(methods("sacfd"), TASK, axis("--shape", "all")),
)
