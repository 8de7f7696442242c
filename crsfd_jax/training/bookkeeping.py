"""What the host keeps of one run: its standing, rows, checkpoints, policies, clips, last words."""

import contextlib
import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from crsfd_jax.config import Config
from crsfd_jax.drawing import learning_curve
from crsfd_jax.errors import UserError
from crsfd_jax.evaluation import Episodes
from crsfd_jax.learn.networks import Params
from crsfd_jax.learn.sac import AgentState
from crsfd_jax.options.schedule import CHUNK_STEPS
from crsfd_jax.progress import say
from crsfd_jax.storage import artefacts, checkpoints, loggers, metrics, policy
from crsfd_jax.storage.run_folder import RunFolder
from crsfd_jax.training import clips, devices, divergence, standing, troubles, verdict
from crsfd_jax.training.standing import Standing
from crsfd_jax.training.train_step import TrainState


class Run(NamedTuple):
    """A run, whose seeds may be a part of those of its program."""

    config: Config
    folder: RunFolder
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


def own(run: Run, whole: Any) -> Any:
    """The run's part [S] of what holds the seeds of all."""
    return whole if run.seeds is None else jax.tree.map(lambda x: x[run.seeds], whole)


def restored(
    folders: Sequence[RunFolder], parts: Sequence[slice | None], like: TrainState
) -> list[checkpoints.Checkpoint | None]:
    """The newest checkpoints of runs, all of one step: a stop may come between two folders.

    Args:
      parts: each run's own seeds among those of `like`; None for all.
      like: the structure of the states.

    Raises:
      UserError: they have no intact step in common, or only one of results and checkpoint.
    """
    while True:
        for folder in folders:
            _refuse_emptied(folder)
        saved = [set(artefacts.saved_steps(folder.checkpoints)) for folder in folders]
        common = set.intersection(*saved)
        # A stop between the first saves: nobody has more than the first chunk to lose.
        if any(saved) and not common and set.union(*saved) != {CHUNK_STEPS}:
            pairs = zip(folders, saved, strict=True)
            stand = " and ".join(f"{folder.path} has {sorted(steps)}" for folder, steps in pairs)
            raise UserError(f"no checkpoint of one step: {stand}; go on with each run by itself")
        most = max(common, default=0) if len(folders) > 1 else math.inf
        found = [
            checkpoints.restore(folder.checkpoints, _part(like, part), most)
            for folder, part in zip(folders, parts, strict=True)
        ]
        if len({each and each.step for each in found}) == 1:
            for folder, each in zip(folders, found, strict=True):
                _refuse_rowless(folder, each)
            return found


def share_time(runs: Sequence[Run], since: float) -> float:
    """Adds the time since then to those of the runs, as much to each; returns what time it is."""
    now = time.monotonic()
    for each in runs:
        each.at.wall_s += (now - since) / len(runs)
    return now


def add_up(run: Run, step: int, values: dict[str, jax.Array]) -> None:
    """Adds the metrics of a chunk that ends at `step`."""
    run.at.step = step
    standing.add_up(run.at, own(run, values))


def evaluated(run: Run, states: TrainState, agent: AgentState, played: Episodes) -> None:
    """Looks for seeds that diverged, and writes the policies and a row for each seed.

    A run without a seed left has come to its end, whatever those beside it do.

    Args:
      states: as the devices hold them; agent and played in every process.
    """
    if run.is_lost:
        return
    at, played = run.at, own(run, played)
    at.success = np.asarray(played.success).mean(axis=1).tolist()
    for index, place in divergence.find(own(run, agent), at.sums).items():
        seed = run.config.seed + index
        if str(seed) not in at.diverged:
            part = own(run, devices.collect(states))
            divergence.keep(run.folder.path, part, index, seed, run.env_steps, place)
            at.diverged[str(seed)] = run.env_steps
    lengths = np.asarray(played.length).mean(axis=1).tolist()
    run.folder.trials.unlink(missing_ok=True)  # They are those of the policy before.
    policy.save(run.folder.policy, own(run, agent.average_actor))
    metrics.append(run.folder.metrics, standing.rows(run.config, at, lengths))
    at.sums = {}


def save(run: Run, whole: TrainState) -> None:
    """Writes a checkpoint, unless that of this step is there."""
    if run.at.step in artefacts.saved_steps(run.folder.checkpoints):
        return
    extra = dataclasses.asdict(run.at)
    checkpoints.save(run.folder.checkpoints, run.at.step, own(run, whole), extra)


def watcher(run: Run, stack: contextlib.ExitStack) -> Callable[[Params], None]:
    """What to call with the actors after each evaluation, for the tools that were asked for."""
    config, path = run.config, run.folder.path
    seeds = range(config.seed, config.seed + config.seeds)
    tool = config.log if devices.is_first() else "none"
    log = stack.enter_context(loggers.opened(tool, path, seeds))
    film = clips.recorder(config, run.folder.clips)

    def watch(actors: Params) -> None:
        log()
        film(own(run, actors), run.env_steps)

    return watch


def conclude(run: Run) -> int:
    """Draws the curves of a run that is over and says what it came to; returns its exit code."""
    config, folder, at = run.config, run.folder, run.at
    if devices.is_first():  # The others keep no rows.
        learning_curve.plot(config.algorithm, folder.metrics, folder.curves)
        say(f"curves    {folder.curves}")
        if met := troubles.words(metrics.read(folder.metrics)):
            say(f"physics   {met}")
    came_to = verdict.judge(config, at.success, at.diverged, at.wall_s)
    say(came_to.line)
    return came_to.code


def _refuse_emptied(folder: RunFolder) -> None:
    """A checkpoint follows the first chunk; with rows of later ones and without, it was removed."""
    kept = artefacts.saved_steps(folder.checkpoints) or any(folder.checkpoints.glob("*.damaged*"))
    if kept or not folder.metrics.exists():
        return
    first = CHUNK_STEPS * artefacts.read_config(folder.path).envs
    if (metrics.read(folder.metrics)["env_steps"] > first).any():
        raise UserError(
            f"{folder.checkpoints}: holds no checkpoint, expected one of a run with the results in "
            f"{folder.metrics.name}; copy it back or choose another --out"
        )


def _refuse_rowless(folder: RunFolder, found: checkpoints.Checkpoint | None) -> None:
    """A run that has been evaluated left rows; going on without them would hide that they went."""
    evaluated = found is not None and found.extra.get("success")
    if evaluated and not metrics.has_rows(folder.metrics):
        raise UserError(
            f"{folder.metrics}: holds no results, expected those of the run whose checkpoints are "
            "beside it; copy it back or choose another --out"
        )


def _part(like: TrainState, seeds: slice | None) -> TrainState:
    """The structure of a part of the seeds."""
    if seeds is None:
        return like
    count = seeds.stop - seeds.start
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct((count, *x.shape[1:]), x.dtype), like)
