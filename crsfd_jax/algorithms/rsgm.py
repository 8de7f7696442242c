"""RS-GM: SACfD shaped by a generative model of the states and actions of the demonstrations.

The reward is r + gamma Phi(s', a') - Phi(s, a) with a' drawn anew at every update, and the actor
maximises Q'(s, a) + Phi(s, a): with a potential of the action, Q' alone would prefer the wrong
ones. Both follow, for 1-step and n-step targets and priorities alike, from one change: the
critic's output becomes Q = Q' + Phi, which is what such shaping amounts to (Wiewiora et al. 2003).
Phi counts as zero beyond a terminal state, as Q does.

Other than in its source the buffer keeps the demonstrations, to be drawn where CRSfD draws them, so
that only the shaping tells this method from CRSfD; the potential has the width, steps and step size
of CRSfD's.

Source: Wu, Mozifian, Shkurti 2021 (arXiv 2011.01298), the potential of a Wasserstein GAN.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from crsfd_jax.algorithms.method import Method, Preparation, in_place
from crsfd_jax.config import Config
from crsfd_jax.learn import wgan
from crsfd_jax.learn.networks import Critic, Networks, Params, apply

WEIGHT = 0.1
"""Largest potential, times the rewards' scale. On shape 3, 40,000 steps of 5 seeds, the area is
0.745, 0.758, 0.694 and 0.025 with 0.03, 0.1, 0.3 and 1."""
FOIL_STD = 0.5
"""Standard deviation of the noise on half of the foils, in units of an observation."""


class ShapedCritic(NamedTuple):
    """A critic whose network learns what is left of the values beside a potential."""

    critic: Critic
    potential: wgan.WganPotential
    weight: float
    """Largest potential, in units of the values."""

    def apply(self, params: Params, obs: jax.Array, action: jax.Array) -> jax.Array:
        """Q [N, ...] = Q' + Phi."""
        phi = wgan.evaluate(self.potential, _pairs(obs, action))
        return apply(self.critic, params, obs, action) + self.weight * phi


def prepare(key: jax.Array, preparation: Preparation, config: Config) -> wgan.WganPotential:
    """Trains the potential; any action in a demonstrated state, or near one, is a foil."""
    fit_key, action_key, obs_key = jax.random.split(key, 3)
    obs, action = preparation.demos.obs, preparation.demos.action
    any_action = jax.random.uniform(action_key, action.shape, minval=-1.0)
    is_near = jnp.arange(len(obs))[:, None] % 2 == 1
    near = obs + FOIL_STD * is_near * jax.random.normal(obs_key, obs.shape)
    rows, foils = _pairs(obs, action), _pairs(near, any_action)
    return wgan.fit(fit_key, rows, foils, config.potential)


def networks(potential: wgan.WganPotential, nets: Networks, config: Config) -> Networks:
    """The common networks with the potential in the critic."""
    critic: Any = ShapedCritic(nets.critic, potential, WEIGHT * config.sac.reward_scale)
    return nets._replace(critic=critic)


def _pairs(obs: jax.Array, action: jax.Array) -> jax.Array:
    return jnp.concatenate([obs, action], axis=-1)


METHOD = Method(
    options=("potential.steps", "potential.learning_rate", "potential.hidden"),
    draws_demos=in_place,
    prepare=prepare,
    networks=networks,
)
