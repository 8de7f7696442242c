"""GAIfO: GAIL whose discriminator sees what an action does and not the action.

Source: Torabi et al. 2018 (arXiv 1807.06158).
"""

import jax
import jax.numpy as jnp

from crsfd_jax.algorithms import gail
from crsfd_jax.types import Transition


def observations(rows: Transition) -> jax.Array:
    """Features of D(s, s')."""
    return jnp.concatenate([rows.obs, rows.next_obs], axis=-1)


METHOD = gail.method(observations)
