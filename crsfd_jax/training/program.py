"""What a run computes: from its options to the functions that the trainer calls.

Runs that differ in task and seeds alone have one program, to which seeds, shapes and shift are
given. It is compiled once for all of them; and it can compute several as one, the seeds of all
standing side by side.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import Mesh

from crsfd_jax import algorithms, evaluation, preparation, task
from crsfd_jax.algorithms.method import Preparation
from crsfd_jax.config import Config, Replay
from crsfd_jax.demos.dataset import Demonstrations
from crsfd_jax.env import Env
from crsfd_jax.options import shapes
from crsfd_jax.options.run_name import default_folder
from crsfd_jax.options.schedule import CHUNK_STEPS, total_env_steps
from crsfd_jax.training import chunk, devices, train_step
from crsfd_jax.training.train_step import Learner, TrainState

_FRESH = 7_919
"""Keeps the keys of evaluation apart from those of training."""
_QUICK_COMPILE = {"xla_backend_optimization_level": 1}
"""For what runs once: the generators of initial weights take half a minute at the full level."""


class Own(NamedTuple):
    """What tells a seed from others, [S] of each in a program."""

    seed: Any
    shapes: Any
    """[n] rows of the scene's shapes that an episode is drawn from."""
    shift: Any
    """m."""


class Program(NamedTuple):
    """The functions of a run, or of several: [S] are the seeds of all."""

    own: Own
    """[S] what to call them with."""
    start: Callable[[Own], TrainState]
    """(own) -> states [S] before the first step."""
    advance: chunk.Chunk
    evaluate: Callable[[Any, Own, jax.typing.ArrayLike], evaluation.Episodes]
    """(actor parameters [S], own, env_steps) -> episodes [S, K]."""
    mesh: Mesh
    """The devices that share the seeds."""


def fitted(config: Config, begun: Config | None = None) -> Config:
    """The configuration with the sizes that a run really uses.

    The buffer need not hold more than the run makes, and a run that goes on with more steps keeps
    the one that it has unless it is told another than it was told at first; the folder gets a name.

    Args:
      begun: the options of the run that the folder holds.
    """
    asked = config.replay.capacity
    capacity = min(asked, total_env_steps(config))
    if begun and (
        asked == Replay().capacity or begun.replay.capacity == min(asked, total_env_steps(begun))
    ):
        capacity = begun.replay.capacity
    replay = dataclasses.replace(config.replay, capacity=capacity)
    return dataclasses.replace(config, replay=replay, out=default_folder(config))


def build(configs: Sequence[Config], demos: Demonstrations) -> Program:
    """Everything that runs compute on their tasks, not compiled yet.

    Args:
      configs: of a run, or of several that `together.require_alike` lets share a program.
    """
    whole = _with_all_shapes(configs)
    return assemble(
        configs,
        lambda own: task.make_env(whole, shapes=own.shapes, shift=own.shift),
        preparation.make(configs[0], demos),
    )


def assemble(
    configs: Sequence[Config],
    make_env: Callable[[Own], Env],
    given: Preparation,
) -> Program:
    """What runs compute on any environment; several devices share the seeds.

    Args:
      make_env: the environment of a seed.
      given: what the method learns from before the first step.
    """
    first, method = configs[0], algorithms.load(configs[0].algorithm)
    own = _own(configs)
    mesh = devices.mesh(len(own.seed))

    def learner_of(own: Own) -> Learner:
        return train_step.make(make_env(own), method, dataclasses.replace(first, shift=own.shift))

    @jax.vmap
    def begin(own: Own) -> TrainState:
        return learner_of(own).init(jax.random.key(own.seed), given)

    def step(state: TrainState, own: Own, step: jax.Array) -> Any:
        return learner_of(own).step(state, step)

    def play(actor: Any, own: Own, env_steps: jax.Array) -> evaluation.Episodes:
        def one(actor, own):
            key = jax.random.fold_in(jax.random.key(own.seed), _FRESH)
            key, nets = jax.random.fold_in(key, env_steps), learner_of(own).nets
            return evaluation.run(make_env(own), nets, actor, key, first.evaluation.episodes)

        return jax.vmap(one)(actor, own)

    start = jax.jit(devices.split(begin, mesh), compiler_options=_QUICK_COMPILE)
    advance = chunk.of_each(step, CHUNK_STEPS, mesh)
    evaluate = jax.jit(devices.split(play, mesh, devices.SEEDS, devices.WHOLE))
    return Program(own, start, advance, evaluate, mesh)


def compiled(program: Program, states: TrainState) -> Program:
    """The program with what is called again and again compiled for such states."""
    own, zero = program.own, np.int32(0)
    advance = program.advance.lower(states, own, zero).compile()
    evaluate = program.evaluate.lower(states.agent.average_actor, own, zero).compile()
    return program._replace(advance=advance, evaluate=evaluate)


def _with_all_shapes(configs: Sequence[Config]) -> Config:
    """The first run's options, with a scene for every run."""
    names = dict.fromkeys(name for config in configs for name in shapes.read(config.shape))
    return dataclasses.replace(configs[0], shape=",".join(names))


def _own(configs: Sequence[Config]) -> Own:
    """What tells the seeds of all runs from each other, [S, ...] each."""
    known = task.shapes_known(_with_all_shapes(configs))
    rows = [[known.index(name) for name in shapes.read(config.shape)] for config in configs]
    shifts = [config.shift for config in configs]
    counts = [config.seeds for config in configs]
    return Own(
        seed=np.array([config.seed + i for config in configs for i in range(config.seeds)]),
        shapes=np.repeat(np.array(rows, np.int32), counts, axis=0),
        shift=np.repeat(np.array(shifts, np.float32), counts),
    )
