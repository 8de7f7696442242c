"""Whole episodes of a policy, recorded."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax.demos.dataset import Demonstrations
from crsfd_jax.demos.provenance import Provenance
from crsfd_jax.env import Env
from crsfd_jax.learn.networks import Actor, Networks, Params, apply
from crsfd_jax.training import train_step
from crsfd_jax.types import Transition


class Expert(NamedTuple):
    """A policy that demonstrates."""

    nets: Networks
    actor: Params
    described: str
    """Where it comes from, in words."""


class Episodes(NamedTuple):
    """Recorded episodes, [T, K] steps each of which only the first `length` count."""

    steps: Transition
    length: np.ndarray
    """[K] int32."""
    start_qpos: np.ndarray
    """[K, 7] rad."""
    socket_offset: np.ndarray
    """[K, 2] m."""


def play(env: Env, expert: Expert, noise: float, key: jax.Array, count: int) -> Episodes:
    """Plays `count` whole episodes, all of them kept.

    Args:
      noise: factor on the standard deviation of the policy.
    """
    reset_key, key = jax.random.split(key)
    start = env.reset(reset_key, count)
    roll = jax.jit(_roll, static_argnums=(0, 1))
    steps, running = roll(env, expert.nets.actor, expert.actor, start, noise, key)
    return Episodes(
        steps=jax.tree.map(np.asarray, steps),
        length=np.asarray(running.sum(axis=0), np.int32),
        start_qpos=np.asarray(start.physics.qpos),
        socket_offset=np.asarray(start.around.socket_offset),
    )


def success_rate(episodes: Episodes) -> float:
    """Share of the episodes that end with the peg inserted."""
    return float(_flatten(episodes).terminated.sum() / len(episodes.length))


def demonstrations(episodes: Episodes, source: Provenance) -> Demonstrations:
    """The episodes one after another, ready to be saved; without those that broke down."""
    last = episodes.length - 1, np.arange(len(episodes.length))
    kept = episodes.steps.terminated[last] | episodes.steps.truncated[last]
    episodes = Episodes(
        steps=jax.tree.map(lambda x: x[:, kept], episodes.steps),
        length=episodes.length[kept],
        start_qpos=episodes.start_qpos[kept],
        socket_offset=episodes.socket_offset[kept],
    )
    return Demonstrations(
        **vars(_flatten(episodes)),
        episode_length=episodes.length,
        start_qpos=episodes.start_qpos,
        socket_offset=episodes.socket_offset,
        provenance=source,
    )


def _flatten(episodes: Episodes) -> Transition:
    """[N] transitions, episode after episode."""
    is_played = np.arange(len(episodes.steps.reward))[:, None] < episodes.length
    return jax.tree.map(lambda x: x.swapaxes(0, 1)[is_played.T], episodes.steps)


def _roll(env: Env, actor: Actor, params: Params, start, noise: float, key: jax.Array):
    def body(carry, key):
        state, running = carry
        noise_key, step_key = jax.random.split(key)
        mean, log_std = apply(actor, params, state.obs)
        deviation = noise * jnp.exp(log_std) * jax.random.normal(noise_key, mean.shape)
        action = jnp.tanh(mean + deviation)
        after, outcome = env.step(state, action, step_key)
        step = train_step.transition_of(state, action, outcome)
        return (after, running & ~outcome.over), (step, running)

    running = jnp.ones(len(start.age), bool)
    return jax.lax.scan(body, (start, running), jax.random.split(key, env.horizon))[1]
