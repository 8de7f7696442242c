"""What the host keeps of one run: its standing, rows, checkpoints, policies, clips, last words."""

import contextlib
import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from crsfd_jax import (
    artefacts,
    checkpoints,
    clips,
    divergence,
    evaluation,
    loggers,
    metrics,
    outcome,
    policy,
    spread,
    standing,
    troubles,
)
from crsfd_jax.config import Config
from crsfd_jax.progress import say
from crsfd_jax.report import curves
from crsfd_jax.standing import Standing
from crsfd_jax.train_step import TrainState


class Run(NamedTuple):
    """A run, whose seeds may be a part of those of its program."""

    config: Config
    folder: artefacts.RunFolder
    seeds: slice | None
    """Its own among those of the program; None for all."""
    at: Standing
    """Changes while the run goes on."""

    @property
    def env_steps(self) -> int:
        """Environment steps of each seed so far."""
        return self.at.step * self.config.envs

    @property
    def is_lost(self) -> bool:
        """Whether all seeds diverged."""
        return len(self.at.diverged) == self.config.seeds


def own(run: Run, tree: Any) -> Any:
    """The run's part [S] of what holds the seeds of all, in every process."""
    whole = spread.collect(tree)
    return whole if run.seeds is None else jax.tree.map(lambda x: x[run.seeds], whole)


def add_up(run: Run, step: int, values: dict[str, jax.Array]) -> None:
    """Adds the metrics of a chunk that ends at `step`."""
    run.at.step = step
    standing.add_up(run.at, own(run, values))


def evaluated(run: Run, states: TrainState, played: evaluation.Episodes) -> None:
    """Looks for seeds that diverged, and writes a row for each seed."""
    at, played = run.at, own(run, played)
    at.success = np.asarray(played.success).mean(axis=1).tolist()
    for index, place in divergence.find(own(run, states.agent), at.sums).items():
        seed = run.config.seed + index
        if str(seed) not in at.diverged:
            states = own(run, states)
            divergence.keep(run.folder.path, states, index, seed, run.env_steps, place)
            at.diverged[str(seed)] = run.env_steps
    lengths = np.asarray(played.length).mean(axis=1).tolist()
    metrics.append(run.folder.metrics, standing.rows(run.config, at, lengths))
    at.sums, at.chunks = {}, 0


def save(run: Run, states: TrainState) -> None:
    """Writes a checkpoint; in the first process only."""
    part = own(run, states)
    if spread.is_first():
        checkpoints.save(run.folder.checkpoints, run.at.step, part, dataclasses.asdict(run.at))


def save_policies(run: Run, states: TrainState) -> None:
    """Writes the parameters of the policies."""
    policy.save(run.folder.path, own(run, states.agent.actor))


def watcher(run: Run, stack: contextlib.ExitStack) -> Callable[[TrainState], None]:
    """What to call after each evaluation, for the other tools that were asked for."""
    config, path = run.config, run.folder.path
    seeds = range(config.seed, config.seed + config.seeds)
    tool = config.log if spread.is_first() else "none"
    log = stack.enter_context(loggers.opened(tool, path, seeds))
    film = clips.recorder(config, path)

    def watch(states: TrainState) -> None:
        log()
        film(own(run, states.agent.actor), run.env_steps)

    return watch


def conclude(run: Run) -> int:
    """Draws the curves of a run that is over and says what it came to; returns its exit code."""
    config, folder, at = run.config, run.folder, run.at
    curves.plot({config.algorithm: folder.metrics}, folder.curves)
    say(f"curves    {folder.curves}")
    met = troubles.words(metrics.read(folder.metrics))
    if met:
        say(f"physics   {met}")
    came_to = outcome.judge(config, at.success, at.diverged, at.wall_s)
    say(came_to.line)
    return came_to.code
