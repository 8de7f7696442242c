"""Discriminator between demonstrations and experience, trained while the policy learns.

Cross-entropy with the label 1 for the demonstrations, plus a penalty on the slope between the two.

Source: Ho and Ermon 2016 (arXiv 1606.03476); Kostrikov et al. 2019 (arXiv 1809.02925, DAC) for
its training from a replay buffer and the penalty of Gulrajani et al. 2017.
"""

from collections.abc import Callable
from typing import cast

import flax.struct
import jax
import jax.numpy as jnp
import optax
from flax import linen as nn

from crsfd_jax.learn.networks import Params, apply, dense

PENALTY = 10.0
"""Weight of the gradient penalty."""
SMALLEST_SPREAD = 0.1
"""Features that vary less in the demonstrations count as if they varied this much."""
_OPTIMISER = optax.adam(3e-4)


@flax.struct.dataclass(kw_only=True)
class Discriminator:
    """A discriminator in training, with the demonstrations that it learns from."""

    params: Params
    optimiser: optax.OptState
    expert: jax.Array
    """[D, F] features of the demonstrations."""
    spread: jax.Array
    """[F] their standard deviations: the unit in which the slope of the score is held near 1."""
    hidden: tuple[int, ...] = flax.struct.field(pytree_node=False)


class Score(nn.Module):
    """Maps features [..., F] to a number [...]; smooth, so that its slope can be trained."""

    hidden: tuple[int, ...]

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        return dense(features, self.hidden, nn.tanh, 1).squeeze(-1)


def init(key: jax.Array, expert: jax.Array, hidden: tuple[int, ...]) -> Discriminator:
    """An untrained discriminator for demonstrations [D, F]."""
    params = Score(hidden).init(key, expert[0])
    return Discriminator(
        params=params,
        optimiser=_OPTIMISER.init(params),
        expert=expert,
        spread=jnp.maximum(jnp.std(expert, axis=0), SMALLEST_SPREAD),
        hidden=hidden,
    )


def logits(discriminator: Discriminator, features: jax.Array) -> jax.Array:
    """Logit [...] that features [..., F] were demonstrated."""
    return apply(Score(discriminator.hidden), discriminator.params, features / discriminator.spread)


def update(discriminator: Discriminator, agent: jax.Array, key: jax.Array) -> Discriminator:
    """One gradient step on experience [B, F] and as many demonstrations."""
    expert_key, mix_key = jax.random.split(key)
    known, spread = discriminator.expert, discriminator.spread
    expert = known[jax.random.randint(expert_key, agent.shape[:1], 0, len(known))]
    mix = jax.random.uniform(mix_key, agent.shape[:1])
    score = Score(discriminator.hidden)
    gradient = jax.grad(loss, argnums=1)(
        score, discriminator.params, expert / spread, agent / spread, mix
    )
    updates, optimiser = _OPTIMISER.update(gradient, discriminator.optimiser)
    params = cast(Params, optax.apply_updates(discriminator.params, updates))
    return discriminator.replace(params=params, optimiser=optimiser)


def loss(
    score: Score, params: Params, expert: jax.Array, agent: jax.Array, mix: jax.Array
) -> jax.Array:
    """mean[-log D(expert)] + mean[-log(1 - D(agent))] + penalty, D the sigmoid of the score.

    Args:
      expert: [B, F].
      agent: [B, F].
      mix: [B] in [0, 1], where between each pair the slope is penalised.
    """
    right = nn.softplus(-apply(score, params, expert)), nn.softplus(apply(score, params, agent))
    steep = slope_penalty(score, params, expert, agent, mix)
    return jnp.mean(right[0]) + jnp.mean(right[1]) + steep


def slope_penalty(
    score: Score, params: Params, real: jax.Array, fake: jax.Array, mix: jax.Array
) -> jax.Array:
    """PENALTY times the gradient penalty between rows [B, F], where mix [B] in [0, 1] says."""
    between = mix[:, None] * real + (1 - mix[:, None]) * fake
    return PENALTY * gradient_penalty(lambda x: apply(score, params, x), between)


def gradient_penalty(function: Callable[[jax.Array], jax.Array], points: jax.Array) -> jax.Array:
    """mean (|grad f| - 1)^2 over points [B, F].

    Source: Gulrajani et al. 2017 (arXiv 1704.00028), equation 3.
    """
    slope = jnp.sum(jax.vmap(jax.grad(function))(points) ** 2, axis=-1)
    # The root has no derivative at zero, where a network of zeros lies.
    return jnp.mean((jnp.sqrt(slope + 1e-12) - 1.0) ** 2)
