"""SACfD: SAC with a prioritised buffer that keeps the demonstrations.

Source: Vecerik et al. 2017 (arXiv 1707.08817) with SAC in the place of DDPG, as in Guo et al. 2022.
"""

from crsfd_jax.algorithms.method import Method

METHOD = Method()
