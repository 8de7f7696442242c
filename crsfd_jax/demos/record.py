"""Trains the expert of the demonstrated task and records its noisy episodes."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax import algorithms, chunk, config, evaluation, task, train_step
from crsfd_jax.algorithms.method import Preparation
from crsfd_jax.demos.expert import dense_reward
from crsfd_jax.demos.options import Record
from crsfd_jax.env import Env, sparse_reward
from crsfd_jax.learn.networks import Actor, Networks, Params, apply
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.types import Transition


class Expert(NamedTuple):
    """A trained policy of the demonstrated task."""

    nets: Networks
    actor: Params
    success_rate: float
    """Of the deterministic policy at the end of its training."""
    env_steps: int


class Episodes(NamedTuple):
    """Recorded episodes, [T, K] steps each of which only the first `length` count."""

    steps: Transition
    length: np.ndarray
    """[K] int32."""
    start_qpos: np.ndarray
    """[K, 7] rad."""
    socket_offset: np.ndarray
    """[K, 2] m."""


def no_demonstrations() -> Transition:
    """Zero transitions, for methods that start from nothing."""
    flags, rows = jnp.zeros(0, bool), jnp.zeros((0, OBS_SIZE))
    return Transition(
        obs=rows,
        action=jnp.zeros((0, ACTION_SIZE)),
        reward=jnp.zeros(0),
        next_obs=rows,
        terminated=flags,
        truncated=flags,
    )


def train_expert(options: Record, report=lambda env_steps, success: None) -> Expert:
    """Trains SAC under the dense reward until it succeeds, or until its steps are used up.

    Args:
      report: called after each evaluation with env steps and success rate.
    """
    run = _training_options(options)
    env = task.make_env(run, dense_reward)
    learner = train_step.make(env, algorithms.load("sac"), run)
    preparation = Preparation(demos=no_demonstrations(), free_space=_no_free_space)
    start_key, evaluation_key = jax.random.split(jax.random.key(options.seed))
    states = jax.vmap(lambda key: learner.init(key, preparation))(start_key[None])
    length = run.evaluation.every // run.envs
    advance = chunk.make(learner, length)
    measure = jax.jit(evaluation.run, static_argnums=(0, 1, 4))
    success, step, actor = 0.0, 0, None
    while actor is None or (step * run.envs < run.steps and success < options.enough):
        states, _ = advance(states, jnp.int32(step))
        step += length
        actor = jax.tree.map(lambda leaf: leaf[0], states.agent.actor)
        key = jax.random.fold_in(evaluation_key, step)
        played = measure(env, learner.nets, actor, key, run.evaluation.episodes)
        success = float(played.success.mean())
        report(step * run.envs, success)
    return Expert(nets=learner.nets, actor=actor, success_rate=success, env_steps=step * run.envs)


def play(options: Record, expert: Expert, key: jax.Array, count: int) -> Episodes:
    """Plays `count` whole episodes with the expert's noise scaled up, all of them kept."""
    env = task.make_env(_training_options(options), sparse_reward)
    reset_key, key = jax.random.split(key)
    start = env.reset(reset_key, count)
    roll = jax.jit(_roll, static_argnums=(0, 1))
    steps, running = roll(env, expert.nets.actor, expert.actor, start, options.noise, key)
    return Episodes(
        steps=jax.tree.map(np.asarray, steps),
        length=np.asarray(running.sum(axis=0), np.int32),
        start_qpos=np.asarray(start.physics.qpos),
        socket_offset=np.asarray(start.around.socket_offset),
    )


def flatten(episodes: Episodes) -> Transition:
    """[N] transitions, episode after episode."""
    is_played = np.arange(len(episodes.steps.reward))[:, None] < episodes.length
    return jax.tree.map(lambda x: x.swapaxes(0, 1)[is_played.T], episodes.steps)


def _roll(env: Env, actor: Actor, params: Params, start, noise: float, key: jax.Array):
    def body(carry, key):
        state, running = carry
        noise_key, step_key = jax.random.split(key)
        mean, log_std = apply(actor, params, state.obs)
        spread = noise * jnp.exp(log_std) * jax.random.normal(noise_key, mean.shape)
        action = jnp.tanh(mean + spread)
        after, outcome = env.step(state, action, step_key)
        step = train_step.transition_of(state, action, outcome)
        over = outcome.terminated | outcome.truncated | ~outcome.finite
        return (after, running & ~over), (step, running)

    running = jnp.ones(len(start.age), bool)
    return jax.lax.scan(body, (start, running), jax.random.split(key, env.horizon))[1]


def _training_options(options: Record) -> config.Config:
    """The expert learns without demonstrations; its buffer holds all of its experience."""
    return config.Config(
        shape=options.shape,
        shift=0.0,
        algorithm="sac",
        seeds=1,
        seed=options.seed,
        steps=options.steps,
        engine=options.engine,
        envs=options.envs,
        scene=options.scene,
        mdp=options.mdp,
        sac=options.sac,
        replay=dataclasses.replace(config.Replay(), capacity=options.steps),
        evaluation=config.Evaluation(every=80 * options.envs),
    )


def _no_free_space(key: jax.Array, count: int) -> jax.Array:
    raise NotImplementedError("the expert's method samples no free space")
