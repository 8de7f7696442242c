"""CRSfD without the regression of free-space states to zero: lambda = 0 in Algorithm 1.

Source: Guo et al. 2022, first arm of the ablation.
"""

import dataclasses

from crsfd_jax.algorithms import crsfd
from crsfd_jax.config import Config


def configure(config: Config) -> Config:
    """Only demonstrated states have a target."""
    potential = dataclasses.replace(config.potential, free_space_weight=0.0)
    return dataclasses.replace(config, potential=potential)


METHOD = crsfd.METHOD._replace(configure=configure, idle=("potential.free_space_extent",))
