"""What a run computes: from its options to the functions that the trainer calls."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.sharding import Mesh

from crsfd_jax import algorithms, chunk, device, evaluation, spread, task, train_step
from crsfd_jax.algorithms.method import Preparation
from crsfd_jax.config import Config, run_name
from crsfd_jax.demos.dataset import Demonstrations
from crsfd_jax.env import Env
from crsfd_jax.free_space import make as make_free_space
from crsfd_jax.train_step import Learner, TrainState
from crsfd_jax.types import Transition

CHUNK_STEPS = 16
"""Vector steps compiled as one program call; a signal is answered after at most one call."""
_FRESH = 7_919
"""Keeps the keys of evaluation apart from those of training."""
_QUICK_COMPILE = {"xla_backend_optimization_level": 1}
"""For what runs once: the generators of initial weights take half a minute at the full level."""


class Program(NamedTuple):
    """The functions of a run."""

    env: Env
    learner: Learner
    start: Callable[[], TrainState]
    """() -> states [S] before the first step."""
    advance: chunk.Chunk
    evaluate: Callable[[Any, jax.typing.ArrayLike], evaluation.Episodes]
    """(actor parameters [S], env_steps) -> episodes [S, K]."""
    mesh: Mesh
    """The devices that share the seeds."""


def fitted(config: Config) -> Config:
    """The configuration with the sizes that a run really uses.

    The buffer need not hold more than the run makes; the folder gets a name.
    """
    made = total_steps(config) * config.envs
    replay = dataclasses.replace(config.replay, capacity=min(config.replay.capacity, made))
    return dataclasses.replace(config, replay=replay, out=config.out or f"runs/{run_name(config)}")


def total_steps(config: Config) -> int:
    """Vector steps of a run: as many whole chunks as reach its environment steps."""
    return -(-config.steps // (config.envs * CHUNK_STEPS)) * CHUNK_STEPS


def evaluation_period(config: Config) -> int:
    """Vector steps between two evaluations: the nearest number of whole chunks."""
    return max(1, round(config.evaluation.every / (config.envs * CHUNK_STEPS))) * CHUNK_STEPS


def build(config: Config, demos: Demonstrations) -> Program:
    """Everything that a run computes on its task, not compiled yet."""
    transitions = Transition(
        **{f.name: jnp.asarray(getattr(demos, f.name)) for f in dataclasses.fields(Transition)}
    )
    _, scene = task.engine(device.engine_name(config), config.scene)
    sampler = make_free_space(scene, config.potential.free_space_extent)
    preparation = Preparation(demos=transitions, free_space=sampler)
    return assemble(config, task.make_env(config), preparation)


def assemble(config: Config, env: Env, preparation: Preparation) -> Program:
    """What a run computes on any environment; several devices share the seeds."""
    learner = train_step.make(env, algorithms.load(config.algorithm), config)
    seeds = jnp.arange(config.seed, config.seed + config.seeds)
    mesh = spread.mesh(config.seeds)

    def begin(seeds: jax.Array) -> TrainState:
        keys = jax.vmap(jax.random.key)(seeds)
        return jax.vmap(lambda key: learner.init(key, preparation))(keys)

    def play(seeds: jax.Array, actor: Any, env_steps: jax.Array) -> evaluation.Episodes:
        def one(actor, seed):
            key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), _FRESH), env_steps)
            return evaluation.run(env, learner.nets, actor, key, config.evaluation.episodes)

        return jax.vmap(one)(actor, seeds)

    def start() -> TrainState:
        return spread.split(begin, mesh)(seeds)

    def evaluate(actor: Any, env_steps: jax.Array) -> evaluation.Episodes:
        return spread.split(play, mesh, spread.SEEDS, spread.WHOLE)(seeds, actor, env_steps)

    start = jax.jit(start, compiler_options=_QUICK_COMPILE)
    advance = chunk.make(learner, CHUNK_STEPS, mesh)
    return Program(env, learner, start, advance, jax.jit(evaluate), mesh)
