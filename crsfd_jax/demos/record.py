"""Trains the expert of the demonstrated task."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax import algorithms, config, evaluation, task
from crsfd_jax.algorithms.method import Preparation
from crsfd_jax.demos.expert import dense_reward
from crsfd_jax.demos.options import Record
from crsfd_jax.demos.rollout import Expert
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.training import chunk, train_step
from crsfd_jax.types import Transition

_BLOCK = 80
"""Vector steps between two looks at how well the expert does."""


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


def train_expert(options: Record, report: Callable[[int, float], None]) -> Expert:
    """Trains SAC under the dense reward until it succeeds, or until its steps are used up.

    Args:
      report: called after each evaluation with env steps and success rate.
    """
    run = training_options(options)
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
        actor = jax.tree.map(lambda leaf: leaf[0], states.agent.average_actor)
        key = jax.random.fold_in(evaluation_key, step)
        played = measure(env, learner.nets, actor, key, run.evaluation.episodes)
        success = float(np.asarray(played.success).mean())
        report(step * run.envs, success)
    described = f"SAC under a dense reward, {step * run.envs} environment steps"
    return Expert(nets=learner.nets, actor=actor, described=described)


def training_options(options: Record) -> config.Config:
    """The expert learns without demonstrations, in blocks; its buffer holds all that they make."""
    block = _BLOCK * options.envs
    whole = -(-options.steps // block) * block
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
        replay=dataclasses.replace(config.Replay(), capacity=whole),
        evaluation=config.Evaluation(every=block),
    )


def _no_free_space(key: jax.Array, count: int) -> jax.Array:
    raise NotImplementedError("the expert's method samples no free space")
