"""RLPD: batches of half demonstrations, half experience, and an ensemble of critics.

The target is the smallest value of a random pair of critics, without the entropy, which
competes with a sparse reward; the actor raises the mean of all critics. Layer normalisation,
the networks, n-step targets and the number of updates are everyone's here.

Source: Ball et al. 2023 (arXiv 2302.02948), with its choices for sparse rewards.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp

from crsfd_jax.algorithms.method import Method
from crsfd_jax.config import Config
from crsfd_jax.learn import halves, sac
from crsfd_jax.learn.networks import Networks, apply, sample_action

CRITICS = 10
SUBSET = 2


def configure(config: Config) -> Config:
    """The size of the ensemble."""
    return dataclasses.replace(config, sac=dataclasses.replace(config.sac, critics=CRITICS))


def subset_value(
    networks: Networks, agent: sac.AgentState, obs: jax.Array, key: jax.Array
) -> jax.Array:
    """min_j Q'_j(s, a) [...] over a random subset of critics, one for the whole batch."""
    action_key, subset_key = jax.random.split(key)
    action, _ = sample_action(networks.actor, agent.actor, obs, action_key)
    chosen = jax.random.choice(subset_key, CRITICS, (SUBSET,), replace=False)
    members = jax.tree.map(lambda leaf: leaf[chosen], agent.target_critic)
    subset = networks.critic.clone(num_critics=SUBSET)
    return jnp.min(apply(subset, members, obs, action), axis=0)


METHOD = Method(
    configure=configure,
    draw=halves.draw,
    update=functools.partial(sac.update, value=subset_value, pool=jnp.mean),
)
