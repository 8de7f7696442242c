"""What a run computes: from its options to the functions that the trainer calls.

Runs that differ in task and seeds alone are computed as one: the seeds of all of them stand side by
side, and each has the shapes and the shift of its run.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import Mesh

from crsfd_jax import algorithms, evaluation, task
from crsfd_jax.algorithms.method import Preparation
from crsfd_jax.config import Config, Replay
from crsfd_jax.demos.dataset import Demonstrations
from crsfd_jax.env import Env
from crsfd_jax.free_space import make as make_free_space
from crsfd_jax.options import shapes
from crsfd_jax.options.run_name import default_folder
from crsfd_jax.training import chunk, devices, train_step
from crsfd_jax.training.train_step import Learner, TrainState

CHUNK_STEPS = 16
"""Vector steps compiled as one program call; a signal is answered after at most one call."""
_FRESH = 7_919
"""Keeps the keys of evaluation apart from those of training."""
_QUICK_COMPILE = {"xla_backend_optimization_level": 1}
"""For what runs once: the generators of initial weights take half a minute at the full level."""


class Program(NamedTuple):
    """The functions of a run, or of several: [S] are the seeds of all."""

    env: Env
    """That of the first seed, as is the learner."""
    learner: Learner
    start: Callable[[], TrainState]
    """() -> states [S] before the first step."""
    advance: chunk.Chunk
    evaluate: Callable[[Any, jax.typing.ArrayLike], evaluation.Episodes]
    """(actor parameters [S], env_steps) -> episodes [S, K]."""
    mesh: Mesh
    """The devices that share the seeds."""


def fitted(config: Config, begun: Config | None = None) -> Config:
    """The configuration with the sizes that a run really uses.

    The buffer need not hold more than the run makes, and a run that goes on with more steps keeps
    the one that it has unless it is told another; the folder gets a name.

    Args:
      begun: the options of the run that the folder holds.
    """
    capacity = min(config.replay.capacity, total_steps(config) * config.envs)
    if begun and config.replay.capacity == Replay().capacity:
        capacity = begun.replay.capacity
    replay = dataclasses.replace(config.replay, capacity=capacity)
    return dataclasses.replace(config, replay=replay, out=default_folder(config))


def total_steps(config: Config) -> int:
    """Vector steps of a run: as many whole chunks as reach its environment steps."""
    return -(-config.steps // (config.envs * CHUNK_STEPS)) * CHUNK_STEPS


def evaluation_period(config: Config) -> int:
    """Vector steps between two evaluations: the nearest number of whole chunks."""
    return max(1, round(config.evaluation.every / (config.envs * CHUNK_STEPS))) * CHUNK_STEPS


def build(configs: Sequence[Config], demos: Demonstrations) -> Program:
    """Everything that runs compute on their tasks, not compiled yet.

    Args:
      configs: of a run, or of several that `together.require_alike` lets share a program.
    """
    first = configs[0]
    sampler = make_free_space(task.scene_of(first), first.potential.free_space_extent)
    preparation = Preparation.of(demos, sampler)
    whole = _with_all_shapes(configs)
    return assemble(configs, lambda drawn: task.make_env(whole, drawn=drawn), preparation)


def assemble(
    configs: Sequence[Config],
    make_env: Callable[[Mapping[str, jax.Array]], Env],
    preparation: Preparation,
) -> Program:
    """What runs compute on any environment; several devices share the seeds.

    Args:
      make_env: from what a seed's episodes are drawn from, where runs differ in that: fields
        of `randomize.Distribution`.
    """
    first, method = configs[0], algorithms.load(configs[0].algorithm)
    own = _own(configs)
    mesh = devices.mesh(len(own["seed"]))
    of_first = {name: values[0] for name, values in own["drawn"].items()}

    def learner_of(drawn: Mapping[str, jax.Array]) -> Learner:
        config: Any = dataclasses.replace(first, shift=drawn.get("shift", first.shift))
        return train_step.make(make_env(drawn), method, config)

    learner = learner_of(of_first)

    @jax.vmap
    def begin(own: dict[str, Any]) -> TrainState:
        return learner_of(own["drawn"]).init(jax.random.key(own["seed"]), preparation)

    def step(state: TrainState, own: dict[str, Any], step: jax.Array) -> Any:
        return learner_of(own["drawn"]).step(state, step)

    def play(own: dict[str, Any], actor: Any, env_steps: jax.Array) -> evaluation.Episodes:
        def one(actor, own):
            key = jax.random.fold_in(jax.random.key(own["seed"]), _FRESH)
            key, env = jax.random.fold_in(key, env_steps), make_env(own["drawn"])
            return evaluation.run(env, learner.nets, actor, key, first.evaluation.episodes)

        return jax.vmap(one)(actor, own)

    def start() -> TrainState:
        return devices.split(begin, mesh)(own)

    def evaluate(actor: Any, env_steps: jax.Array) -> evaluation.Episodes:
        return devices.split(play, mesh, devices.SEEDS, devices.WHOLE)(own, actor, env_steps)

    start = jax.jit(start, compiler_options=_QUICK_COMPILE)
    advance = chunk.of_each(step, own, CHUNK_STEPS, mesh)
    return Program(make_env(of_first), learner, start, advance, jax.jit(evaluate), mesh)


def _with_all_shapes(configs: Sequence[Config]) -> Config:
    """The first run's options, with a scene for every run."""
    names = dict.fromkeys(name for config in configs for name in shapes.read(config.shape))
    return dataclasses.replace(configs[0], shape=",".join(names))


def _own(configs: Sequence[Config]) -> dict[str, Any]:
    """[S] what tells a seed from the others; what all have in common is left to the options."""
    known = task.shapes_known(_with_all_shapes(configs))
    rows = [[known.index(name) for name in shapes.read(config.shape)] for config in configs]
    shifts = [config.shift for config in configs]
    each = {"shapes": np.array(rows, np.int32), "shift": np.array(shifts, np.float32)}
    runs = np.repeat(np.arange(len(configs)), [config.seeds for config in configs])
    seeds = [config.seed + i for config in configs for i in range(config.seeds)]
    drawn = {name: v[runs] for name, v in each.items() if (v != v[0]).any()}
    return {"seed": np.array(seeds), "drawn": drawn}
