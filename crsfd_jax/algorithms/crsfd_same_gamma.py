"""CRSfD without the larger discount: the potential's gamma_0 is raised to gamma_k.

The paper's arm says gamma_k = gamma_0. Lowering gamma_k would also change the task that is
learned and the horizon of the learner, and no longer compare with the other methods; raising
gamma_0 takes away the gap alone. On a demonstration the shaped reward is then zero but for the
step that succeeds.

Source: Guo et al. 2022, second arm of the ablation.
"""

import dataclasses

from crsfd_jax.algorithms import crsfd
from crsfd_jax.config import Config


def configure(config: Config) -> Config:
    """Values the demonstrations with the discount of the new task."""
    potential = dataclasses.replace(config.potential, gamma=config.sac.gamma)
    return dataclasses.replace(config, potential=potential)


METHOD = crsfd.METHOD._replace(configure=configure)
