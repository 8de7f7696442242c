"""SAC: no demonstrations, and a uniform buffer.

Source: Haarnoja et al. 2018 (arXiv 1812.05905).
"""

import dataclasses

from crsfd_jax.algorithms.method import Method
from crsfd_jax.config import Config


def configure(config: Config) -> Config:
    """Every row is drawn with the same chance and the same weight."""
    uniform = dataclasses.replace(config.replay, priority_exponent=0.0, importance_exponent=0.0)
    return dataclasses.replace(config, replay=uniform)


METHOD = Method(uses_demos=False, configure=configure)
