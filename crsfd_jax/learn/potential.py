"""Conservative value function of the demonstrations, the potential of reward shaping.

A network is regressed to the Monte-Carlo returns on demonstrated states and to zero on states
drawn from free space. Its output lies between 0 and 1, the largest return of a task that
pays 1 once: a negative potential would reward standing still.

Source: Guo et al. 2022, Algorithm 1.
"""

import functools
from collections.abc import Callable
from typing import Any, cast

import flax.struct
import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import linen as nn

from crsfd_jax import config
from crsfd_jax.learn.networks import Params, apply, dense
from crsfd_jax.learn.returns import monte_carlo_returns
from crsfd_jax.types import Transition

FreeSpace = Callable[[jax.Array, int], jax.Array]
"""Maps a key and a count n to features [n, F] spread over the free space."""
Move = Callable[[jax.Array, jax.Array], jax.Array]
"""Maps a key and features [n, F] of demonstrations to where else they are as good."""
_MOVING = 7
"""Folded into the key of a batch of demonstrations, whose rows are drawn with it."""


@flax.struct.dataclass(kw_only=True)
class FittedPotential:
    """A fitted potential; frozen while the policy learns."""

    params: Params
    hidden: tuple[int, ...] = flax.struct.field(pytree_node=False)


class _Value(nn.Module):
    hidden: tuple[int, ...]

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        return nn.sigmoid(dense(features, self.hidden, nn.relu, 1).squeeze(-1))


def demonstration_targets(
    demos: Transition, potential: config.Potential
) -> tuple[np.ndarray, np.ndarray]:
    """Observations [D', O] of the demonstrations and the values [D'] to regress them to.

    Episodes that fail have no part in it. Their return is zero all the way, and where many fail,
    it would hold the potential down along the way in as if that were free space.

    With `potential.terminal` at "keep", the success states are appended with the largest
    value, 1: one step on from a return of 1 it would be 1 / gamma_0.
    """
    obs = np.asarray(demos.obs)
    targets = monte_carlo_returns(demos, potential.gamma)
    succeeds = targets > 0
    obs, targets = obs[succeeds], targets[succeeds]
    if potential.terminal == "keep":
        success_obs = np.asarray(demos.next_obs)[np.asarray(demos.terminated)]
        obs = np.concatenate([obs, success_obs])
        targets = np.concatenate([targets, np.ones(len(success_obs), np.float32)])
    return obs, targets


@functools.partial(jax.jit, static_argnames=("free_space", "potential", "move"))
def fit(
    key: jax.Array,
    features: jax.Array,
    targets: jax.Array,
    free_space: FreeSpace,
    potential: config.Potential,
    move: Move,
) -> FittedPotential:
    """Runs the regression on features [D, F] with targets [D] in [0, 1].

    Args:
      move: applied to each batch of demonstrations, so that the regression finds the mean of
        the targets over what it draws.
    """
    init_key, loop_key = jax.random.split(key)
    hidden = potential.hidden
    fitted = FittedPotential(params=_Value(hidden).init(init_key, features[0]), hidden=hidden)
    optimiser = optax.adam(potential.learning_rate)
    opt_state = optimiser.init(cast(Any, fitted))

    def regress(carry, step_key):
        fitted, opt_state = carry
        demo_key, free_key = jax.random.split(step_key)
        rows = jax.random.randint(demo_key, (potential.batch_size,), 0, features.shape[0])
        free = free_space(free_key, potential.batch_size)
        known = move(jax.random.fold_in(demo_key, _MOVING), features[rows])
        gradient = jax.grad(regression_loss)(
            fitted, known, targets[rows], free, potential.free_space_weight
        )
        updates, opt_state = optimiser.update(gradient, opt_state)
        fitted = cast(Any, optax.apply_updates(cast(Any, fitted), updates))
        return (fitted, opt_state), None

    step_keys = jax.random.split(loop_key, potential.steps)
    (fitted, _), _ = jax.lax.scan(regress, (fitted, opt_state), step_keys)
    return fitted


def evaluate(potential: FittedPotential, features: jax.Array) -> jax.Array:
    """Potential [...] in [0, 1] of features [..., F]."""
    return apply(_Value(potential.hidden), potential.params, features)


def regression_loss(
    potential: FittedPotential,
    features: jax.Array,
    targets: jax.Array,
    free_space: jax.Array,
    free_space_weight: float,
) -> jax.Array:
    """Mean squared error on demonstrations plus lambda times the mean square in free space."""
    demo_term = jnp.mean((evaluate(potential, features) - targets) ** 2)
    return demo_term + free_space_weight * jnp.mean(evaluate(potential, free_space) ** 2)
