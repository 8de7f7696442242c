"""Success rate of the deterministic policy on fresh episodes."""

import flax.struct
import jax
import jax.numpy as jnp

from crsfd_jax.env import Env
from crsfd_jax.learn.networks import Networks, Params, mode_action


@flax.struct.dataclass(kw_only=True)
class Episodes:
    """How K episodes went; [K] each."""

    success: jax.Array
    length: jax.Array
    """int32 control steps until insertion, the horizon or a breakdown of the simulation."""
    shape: jax.Array
    """int32 row of the scene's geometry tables."""


def run(env: Env, nets: Networks, actor: Params, key: jax.Array, episodes: int) -> Episodes:
    """Plays whole episodes from fresh starts; success is insertion at any time before the limit.

    Every environment plays exactly one episode: what happens after its end is not counted, and the
    simulation stops with the last of them.
    """
    reset_key, key = jax.random.split(key)
    keys = jax.random.split(key, env.horizon)

    def going(carry):
        step, _, running, _, _ = carry
        return (step < env.horizon) & running.any()

    def play(carry):
        step, state, running, success, length = carry
        action = mode_action(nets.actor, actor, state.obs)
        state, outcome = env.step(state, action, keys[step])
        success = success | (running & outcome.terminated)
        return step + 1, state, running & ~outcome.over, success, length + running

    start = env.reset(reset_key, episodes)
    running, success = jnp.ones(episodes, bool), jnp.zeros(episodes, bool)
    carry = (0, start, running, success, jnp.zeros(episodes, jnp.int32))
    _, _, _, success, length = jax.lax.while_loop(going, play, carry)
    return Episodes(success=success, length=length, shape=start.around.shape)
