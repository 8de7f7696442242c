"""BC: behaviour cloning; the deterministic action is regressed to the demonstrated one.

It makes as many updates in a step as every method and never meets the task before it is evaluated;
the experiments give it 40,000 steps, also beside runs of 300,000 of the others. The weights are
free: a penalty of 1e-3 on their squares cut the squared error on four demonstrations left out from
0.22 to 0.12, but the success on shape 2 from 1.00 to 0.75.

Source: Pomerleau 1988; the squared error, and not the likelihood, of the squashed Gaussian,
which has no bound at actions close to 1 or -1.
"""

import dataclasses

import jax
import jax.numpy as jnp

from crsfd_jax.algorithms.method import Method
from crsfd_jax.config import Config
from crsfd_jax.learn import halves, sac
from crsfd_jax.learn.networks import Networks, Params, mode_action
from crsfd_jax.learn.replay import Batch


def configure(config: Config) -> Config:
    """No experience is stored: the ring is as small as it can be."""
    replay = dataclasses.replace(config.replay, capacity=config.envs)
    return dataclasses.replace(config, replay=replay)


def regression_loss(actor: Params, networks: Networks, batch: Batch) -> tuple[jax.Array, jax.Array]:
    """mean_i |tanh(mean(s_i)) - a_i|^2, and the root-mean-square error of each action [B]."""
    square = jnp.mean((mode_action(networks.actor, actor, batch.obs) - batch.action) ** 2, axis=-1)
    return jnp.mean(square), jnp.sqrt(square)


def update(
    networks: Networks, agent: sac.AgentState, batch: Batch, key: jax.Array, config: Config
) -> tuple[sac.AgentState, jax.Array, dict[str, jax.Array]]:
    """One gradient step of the actor on a batch [B]; critics and temperature stay."""
    (loss, error), gradient = jax.value_and_grad(regression_loss, has_aux=True)(
        agent.actor, networks, batch
    )
    idle = jax.tree.map(jnp.zeros_like, (agent.critic, agent.log_alpha))
    agent = sac.apply_gradients(agent, (gradient, *idle), config)
    return agent, error, {"actor_loss": loss}


_OF_CRITICS = ("critics", "tau", "initial_alpha", "target_entropy")
METHOD = Method(
    interacts=False,
    idle=(*(f"sac.{name}" for name in _OF_CRITICS), "replay.n_step", "replay.n_step_weight"),
    configure=configure,
    draw=halves.draw,
    update=update,
)
