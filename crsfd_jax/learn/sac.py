"""Soft actor-critic on prioritised batches with 1-step and n-step targets (SACfD).

All three gradients are taken at the same parameters and applied by one optimiser step.
Truncation plays no part here: only a terminal step cuts the bootstrap.

Source: Haarnoja et al. 2018 (arXiv 1812.05905); Vecerik et al. 2017 (arXiv 1707.08817) for
the mix of 1-step and n-step losses.
"""

from collections.abc import Callable
from typing import cast

import chex
import flax.struct
import jax
import jax.numpy as jnp
import optax

from crsfd_jax.config import Config
from crsfd_jax.learn.networks import Networks, Params, apply, sample_action
from crsfd_jax.learn.replay import Backup, Batch

Value = Callable[..., jax.Array]
"""(networks, agent, obs [..., O], key) -> value [...] of the observations."""
Pool = Callable[..., jax.Array]
"""(values [N, ...], axis=0) -> values [...], such as jnp.min or jnp.mean."""


@flax.struct.dataclass(kw_only=True)
class AgentState:
    """Everything the learner changes."""

    actor: Params
    average_actor: Params
    """Follows the actor as the target critic follows the critic. Nothing learns from it: it is what
    is evaluated and kept, because the actor of a single update may happen to be a bad one."""
    critic: Params
    target_critic: Params
    log_alpha: jax.Array
    optimiser: optax.OptState


def init(networks: Networks, obs_size: int, key: jax.Array, config: Config) -> AgentState:
    """Fresh parameters; target critic and averaged actor start as copies of critic and actor."""
    actor_key, critic_key = jax.random.split(key)
    obs, action = jnp.zeros(obs_size), jnp.zeros(networks.actor.action_size)
    actor = networks.actor.init(actor_key, obs)
    critic = networks.critic.init(critic_key, obs, action)
    log_alpha = jnp.log(jnp.asarray(config.sac.initial_alpha, jnp.float32))
    return AgentState(
        actor=actor,
        average_actor=jax.tree.map(jnp.copy, actor),
        critic=critic,
        target_critic=jax.tree.map(jnp.copy, critic),
        log_alpha=log_alpha,
        optimiser=_optimiser(config).init((actor, critic, log_alpha)),
    )


def soft_value(networks: Networks, agent: AgentState, obs: jax.Array, key: jax.Array) -> jax.Array:
    """min_j Q'_j(s, a) - alpha log pi(a|s) [...] for obs [..., O], a drawn from the policy."""
    action, log_prob = sample_action(networks.actor, agent.actor, obs, key)
    q = apply(networks.critic, agent.target_critic, obs, action)
    return jnp.min(q, axis=0) - jnp.exp(agent.log_alpha) * log_prob


def update(
    networks: Networks,
    agent: AgentState,
    batch: Batch,
    key: jax.Array,
    config: Config,
    value: Value = soft_value,
    pool: Pool = jnp.min,
) -> tuple[AgentState, jax.Array, dict[str, jax.Array]]:
    """One gradient step on a batch [B].

    Args:
      value: what the targets bootstrap from.
      pool: reduces the critics' values of an action to the one that the actor raises.

    Returns:
      The new agent, the td_error [B] for the priorities, and scalar metrics.
    """
    target_key, actor_key = jax.random.split(key)
    backup, target_weights = _backups(batch, config)
    targets = bootstrap_targets(networks, agent, backup, config.sac.gamma, target_key, value)
    (critic_value, (td_error, q)), critic_grad = jax.value_and_grad(critic_loss, has_aux=True)(
        agent.critic, networks, batch, targets, target_weights
    )
    alpha = jnp.exp(agent.log_alpha)
    (actor_value, log_prob), actor_grad = jax.value_and_grad(actor_loss, has_aux=True)(
        agent.actor, networks, agent, batch, actor_key, pool
    )
    alpha_grad = jax.grad(temperature_loss)(agent.log_alpha, log_prob, config.sac.target_entropy)
    agent = apply_gradients(agent, (actor_grad, critic_grad, alpha_grad), config)
    metrics = {
        "critic_loss": critic_value,
        "actor_loss": actor_value,
        "alpha": alpha,
        "entropy": -jnp.mean(log_prob),
        "q": jnp.mean(q),
        "td_error": jnp.mean(td_error),
    }
    return agent, td_error, metrics


def critic_loss(
    critic: Params, networks: Networks, batch: Batch, targets: jax.Array, target_weights: jax.Array
) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    """sum_j mean_i w_i sum_k lambda_k (Q_j - y_k)^2.

    Args:
      targets: [K, B] the 1-step target, then the n-step target if it is used.
      target_weights: [K] lambda, 1 for the 1-step target.

    Returns:
      The loss, and (mean_j |Q_j - y_1| [B], Q [N, B]).
    """
    q = apply(networks.critic, critic, batch.obs, batch.action)
    chex.assert_shape(targets, (target_weights.shape[0], q.shape[-1]))
    error = q[:, None, :] - targets
    loss = jnp.sum(jnp.mean(batch.weight * error**2, axis=-1) * target_weights)
    return loss, (jnp.mean(jnp.abs(error[:, 0]), axis=0), q)


def actor_loss(
    actor: Params,
    networks: Networks,
    agent: AgentState,
    batch: Batch,
    key: jax.Array,
    pool: Pool,
) -> tuple[jax.Array, jax.Array]:
    """mean_i w_i [alpha log pi(a|s_i) - pool_j Q_j(s_i, a)], and log pi [B]."""
    action, log_prob = sample_action(networks.actor, actor, batch.obs, key)
    q = pool(apply(networks.critic, agent.critic, batch.obs, action), axis=0)
    loss = jnp.mean(batch.weight * (jnp.exp(agent.log_alpha) * log_prob - q))
    return loss, log_prob


def temperature_loss(log_alpha: jax.Array, log_prob: jax.Array, target_entropy: float) -> jax.Array:
    """mean[-alpha (log pi + target entropy)]: alpha falls while the entropy is above it."""
    return -jnp.exp(log_alpha) * jnp.mean(jax.lax.stop_gradient(log_prob) + target_entropy)


def bootstrap_targets(
    networks: Networks,
    agent: AgentState,
    backup: Backup,
    gamma: float,
    key: jax.Array,
    value: Value,
) -> jax.Array:
    """r + gamma^m (1 - terminated) V(s')."""
    after = value(networks, agent, backup.next_obs, key)
    return backup.reward + gamma**backup.length * jnp.where(backup.terminated, 0.0, after)


def _backups(batch: Batch, config: Config) -> tuple[Backup, jax.Array]:
    """Backups [K, B] and their loss weights [K]; their bootstraps share one forward pass."""
    backups, weights = [batch.one_step], [1.0]
    if config.replay.n_step > 1 and config.replay.n_step_weight > 0:
        backups.append(batch.n_step)
        weights.append(config.replay.n_step_weight)
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *backups), jnp.asarray(weights)


def apply_gradients(agent: AgentState, gradients: tuple, config: Config) -> AgentState:
    """One optimiser step along the gradients of (actor, critic, log_alpha)."""
    params = (agent.actor, agent.critic, agent.log_alpha)
    updates, optimiser = _optimiser(config).update(gradients, agent.optimiser)
    actor, critic, log_alpha = cast(tuple, optax.apply_updates(params, updates))
    target_critic = optax.incremental_update(critic, agent.target_critic, config.sac.tau)
    average_actor = optax.incremental_update(actor, agent.average_actor, config.sac.actor_tau)
    return AgentState(
        actor=actor,
        average_actor=average_actor,
        critic=critic,
        target_critic=target_critic,
        log_alpha=log_alpha,
        optimiser=optimiser,
    )


def _optimiser(config: Config) -> optax.GradientTransformation:
    return optax.adam(config.sac.learning_rate)
