"""A state-action potential that is high where demonstrations are: the critic of a Wasserstein GAN.

A generator learns to make rows that look demonstrated, and a critic to tell them apart. The critic
is what is kept. It is only known up to its offset and scale, so both are fixed afterwards, and a
sigmoid bounds it.

Every other fake is a foil: a row known to be off the demonstrations. Without them the critic knows
only the places where the generator has been: with penalties from 0.1 to 10 and step sizes from
1e-4 to 1e-3 it came out flat, or upside down with random actions above demonstrated ones.

Source: Wu, Mozifian, Shkurti 2021 (arXiv 2011.01298); Gulrajani et al. 2017 (arXiv 1704.00028).
"""

import functools
from collections.abc import Callable
from typing import Any

import flax.struct
import jax
import jax.numpy as jnp
import optax
from flax import linen as nn

from crsfd_jax import config
from crsfd_jax.learn.discriminator import Score, slope_penalty
from crsfd_jax.learn.networks import Params, apply, dense

CRITIC_STEPS = 5
"""Steps of the critic for each one of the generator."""
LATENT = 6
"""Uniform numbers that the generator makes a row of."""
BATCH = 128
"""Demonstrated rows, and as many fakes, in a step."""
STEEPNESS = 2.0
"""The potential is sigmoid(2) = 0.88 at a middling demonstrated row, sigmoid(-2) at a foil."""


@flax.struct.dataclass(kw_only=True)
class WganPotential:
    """A trained potential; frozen while the policy learns."""

    params: Params
    middle: jax.Array
    """[] score halfway between demonstrated rows and foils."""
    scale: jax.Array
    """[] distance of either from it."""
    hidden: tuple[int, ...] = flax.struct.field(pytree_node=False)


class _Generator(nn.Module):
    hidden: tuple[int, ...]
    size: int

    @nn.compact
    def __call__(self, latent: jax.Array) -> jax.Array:
        return dense(latent, self.hidden, nn.relu, self.size)


@functools.partial(jax.jit, static_argnames="options")
def fit(
    key: jax.Array, rows: jax.Array, foils: jax.Array, options: config.Potential
) -> WganPotential:
    """Trains on demonstrated rows [D, F] with `options.steps` steps of the critic.

    Args:
      foils: [N, F] rows off the demonstrations; on average they lie as far below the middle of
        the potential as `rows` above it.
    """
    score, generator = Score(options.hidden), _Generator(options.hidden, rows.shape[-1])
    optimiser = optax.adam(options.learning_rate, b1=0.5, b2=0.9)
    critic_key, generator_key, loop_key = jax.random.split(key, 3)
    critic = score.init(critic_key, rows[0])
    made = generator.init(generator_key, jnp.zeros(LATENT))

    def generate(made: Params, key: jax.Array) -> jax.Array:
        latent = jax.random.uniform(key, (BATCH, LATENT), minval=-1.0)
        return apply(generator, made, latent)

    def pick(key: jax.Array, table: jax.Array) -> jax.Array:
        return table[jax.random.randint(key, (BATCH,), 0, len(table))]

    def descend(loss: Callable[[Params], jax.Array], params: Params, state: Any) -> Any:
        updates, state = optimiser.update(jax.grad(loss)(params), state)
        return optax.apply_updates(params, updates), state

    def train_critic(made, critic, key):
        row_key, fake_key, foil_key, mix_key = jax.random.split(key, 4)
        real, wide = (pick(*each) for each in ((row_key, rows), (foil_key, foils)))
        mix = jax.random.uniform(mix_key, (BATCH,))
        is_foil = jnp.arange(BATCH)[:, None] % 2 == 1
        fake = jnp.where(is_foil, wide, generate(made, fake_key))
        return descend(lambda p: critic_loss(score, p, real, fake, mix), *critic), None

    def train_both(carry, key):
        critic, made = carry
        critic_key, made_key = jax.random.split(key)
        keys = jax.random.split(critic_key, CRITIC_STEPS)
        critic, _ = jax.lax.scan(functools.partial(train_critic, made[0]), critic, keys)
        made = descend(lambda p: -jnp.mean(apply(score, critic[0], generate(p, made_key))), *made)
        return (critic, made), None

    start = (critic, optimiser.init(critic)), (made, optimiser.init(made))
    keys = jax.random.split(loop_key, -(-options.steps // CRITIC_STEPS))
    ((critic, _), _), _ = jax.lax.scan(train_both, start, keys)
    return _scaled(score, critic, rows, foils)


def critic_loss(
    score: Score, params: Params, real: jax.Array, fake: jax.Array, mix: jax.Array
) -> jax.Array:
    """mean f(fake) - mean f(real) + penalty, for rows [B, F] and mix [B] in [0, 1]."""
    steep = slope_penalty(score, params, real, fake, mix)
    gap = jnp.mean(apply(score, params, fake)) - jnp.mean(apply(score, params, real))
    return gap + steep


def evaluate(potential: WganPotential, rows: jax.Array) -> jax.Array:
    """Potential [...] in (0, 1) of rows [..., F]."""
    score = apply(Score(potential.hidden), potential.params, rows)
    return nn.sigmoid(STEEPNESS * (score - potential.middle) / potential.scale)


def _scaled(score: Score, params: Params, rows: jax.Array, foils: jax.Array) -> WganPotential:
    high, low = (jnp.mean(apply(score, params, x)) for x in (rows, foils))
    return WganPotential(
        params=params, middle=(high + low) / 2, scale=(high - low) / 2, hidden=score.hidden
    )
