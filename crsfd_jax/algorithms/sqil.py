"""SQIL: reward 1 on demonstrations and 0 on experience.

Rewards are times 1 - gamma, so that values lie in [0, 1] as everyone's do, before the scale of
rewards. Success leads to an absorbing state in which only the demonstrator is seen: it pays for
ever, so it is worth 1, and a step into it bootstraps from that, whoever makes it. Were an end of
the agent's own worth nothing, waiting beside the goal would be worth more than reaching it. All
ends of this task are successes: what is worth 1 there is, though never read, the task's reward.

Source: Reddy et al. 2020 (arXiv 1905.11108), on soft actor-critic.
"""

from typing import Any

import jax
import jax.numpy as jnp

from crsfd_jax.algorithms.method import Method
from crsfd_jax.config import Config
from crsfd_jax.learn import halves
from crsfd_jax.learn.replay import Draw, ReplayState


def relabel(prepared: Any, buffer: ReplayState, draw: Draw, config: Config) -> jax.Array:
    """Rewards [U, B, n]; that of a terminal step includes what the absorbing state is worth."""
    gamma = config.sac.gamma
    reward = jnp.where(draw.rows < buffer.num_demos, 1.0 - gamma, 0.0)
    absorbed = jnp.where(buffer.storage.terminated[draw.rows], gamma, 0.0)
    return reward + absorbed


METHOD = Method(draw=halves.draw, relabel=relabel)
