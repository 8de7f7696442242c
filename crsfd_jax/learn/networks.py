"""Actor and critic networks of soft actor-critic, and the tanh-Gaussian policy.

Source: Haarnoja et al. 2018 (arXiv 1812.05905), appendix C for the squashing.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from crsfd_jax import config

Params = Any
LOG_STD_RANGE = (-5.0, 2.0)


def dense(
    x: jax.Array, hidden: tuple[int, ...], activation: Callable[[jax.Array], jax.Array], size: int
) -> jax.Array:
    """Layers Dense_0, Dense_1, ... of a module that calls this in its compact method."""
    for width in hidden:
        x = activation(nn.Dense(width)(x))
    return nn.Dense(size)(x)


class Actor(nn.Module):
    """Maps obs [..., O] to mean and log standard deviation [..., A] before the tanh."""

    hidden: tuple[int, ...]
    action_size: int

    @nn.compact
    def __call__(self, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        both = dense(obs, self.hidden, nn.relu, 2 * self.action_size)
        mean, raw = jnp.split(both, 2, axis=-1)
        low, high = LOG_STD_RANGE
        # Squashed and not clipped: a clipped value would get no gradient back into the range.
        return mean, low + (high - low) * nn.sigmoid(raw)


class QFunction(nn.Module):
    """Maps obs [..., O] and action [..., A] to a value [...]."""

    hidden: tuple[int, ...]

    @nn.compact
    def __call__(self, obs: jax.Array, action: jax.Array) -> jax.Array:
        x = jnp.concatenate([obs, action], axis=-1)
        for width in self.hidden:
            # Normalising bounds what the critic says off the data; without it values diverge.
            x = nn.relu(nn.LayerNorm(use_bias=False, use_scale=False)(nn.Dense(width)(x)))
        return nn.Dense(1)(x).squeeze(-1)


class Critic(nn.Module):
    """Ensemble of Q functions with a leading member axis [N, ...] on the values."""

    hidden: tuple[int, ...]
    num_critics: int

    @nn.compact
    def __call__(self, obs: jax.Array, action: jax.Array) -> jax.Array:
        ensemble = nn.vmap(
            QFunction,
            variable_axes={"params": 0},
            split_rngs={"params": True},
            in_axes=None,  # pyright: ignore[reportArgumentType]
            axis_size=self.num_critics,
        )
        return ensemble(self.hidden)(obs, action)


class Networks(NamedTuple):
    """The network definitions; their parameters live in the learner's state."""

    actor: Actor
    critic: Critic


def make_networks(sac: config.Sac, action_size: int) -> Networks:
    """Networks with the hidden widths and the number of critics of the configuration."""
    return Networks(Actor(sac.hidden, action_size), Critic(sac.hidden, sac.critics))


def apply(module: nn.Module, params: Params, *inputs: jax.Array) -> Any:
    """Output of the module; flax's own return type is a union that no caller can use."""
    return module.apply(params, *inputs)


def log_prob(mean: jax.Array, log_std: jax.Array, pre_tanh: jax.Array) -> jax.Array:
    """Log density [...] of the action tanh(pre_tanh), summed over the last axis.

    log(1 - tanh(u)^2) is written as 2 (log 2 - u - softplus(-2u)), finite for every u.
    """
    noise = (pre_tanh - mean) * jnp.exp(-log_std)
    normal = -0.5 * noise**2 - log_std - 0.5 * jnp.log(2 * jnp.pi)
    jacobian = 2 * (jnp.log(2.0) - pre_tanh - nn.softplus(-2 * pre_tanh))
    return jnp.sum(normal - jacobian, axis=-1)


def sample_action(
    actor: Actor, params: Params, obs: jax.Array, key: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Draws an action [..., A] in (-1, 1) and its log density [...] for obs [..., O]."""
    mean, log_std = apply(actor, params, obs)
    pre_tanh = mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape)
    return jnp.tanh(pre_tanh), log_prob(mean, log_std, pre_tanh)


def mode_action(actor: Actor, params: Params, obs: jax.Array) -> jax.Array:
    """The deterministic action tanh(mean) [..., A], used in evaluation."""
    mean, _ = apply(actor, params, obs)
    return jnp.tanh(mean)
