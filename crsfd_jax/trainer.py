"""The host's side of a run: compile, advance, evaluate, record, save, stop, resume."""

import contextlib
import dataclasses
import json
import os
import shlex
import sys
import tempfile
import time
from collections.abc import Iterator

import jax
import numpy as np

from crsfd_jax import (
    artefacts,
    checkpoints,
    clips,
    device,
    divergence,
    loggers,
    metrics,
    outcome,
    policy,
    spread,
    standing,
    troubles,
)
from crsfd_jax.config import Config
from crsfd_jax.demos.dataset import Demonstrations
from crsfd_jax.errors import STOPPED, USAGE, UserError
from crsfd_jax.interrupt import Interrupt
from crsfd_jax.leaves import stored_bytes
from crsfd_jax.program import (
    CHUNK_STEPS,
    Program,
    build,
    evaluation_period,
    fitted,
    total_steps,
)
from crsfd_jax.progress import progress, say
from crsfd_jax.report import curves
from crsfd_jax.standing import Standing
from crsfd_jax.train_step import TrainState

_SAVE_SHARE = 0.02
"""Largest share of the wall time that saving may take."""


def train(config: Config, demos: Demonstrations) -> int:
    """Runs or continues a run to its end, or until a signal stops it; returns the exit code.

    Raises:
      UserError: the run cannot start or go on: run folder, disk, memory or engine.
    """
    config = fitted(config)
    words = device.describe(config)
    with (
        _place(config) as path,
        artefacts.open_run(path, config, words, sys.argv) as folder,
        Interrupt() as interrupt,
        _memory_reported(folder),
    ):
        program = build(config, demos)
        size = stored_bytes(jax.eval_shape(program.start))
        artefacts.refuse_full_disk(folder, size)
        say(f"device    {words}")
        if jax.device_count() > 1:
            devices = f"{program.mesh.size} of {jax.device_count()} devices"
            say(f"seeds     {config.seeds}, evenly on {devices}, {jax.process_count()} processes")
        say(f"task      shape {config.shape}, shift {config.shift * 1e3:g} mm, {config.algorithm}")
        say(f"buffer    {config.replay.capacity} transitions a seed, {size / 1e6:.0f} MB in all")
        say(f"folder    {folder.path}")
        return run(config, program, folder, interrupt)


def run(config: Config, program: Program, folder: artefacts.RunFolder, interrupt: Interrupt) -> int:
    """Starts or resumes, and goes on to the end or to a signal; returns the exit code."""
    states, at = _start_or_resume(config, program, folder)
    if not _is_over(config, at):
        program = _compiled(program, states)
    began, saved_at, save_s = time.monotonic() - at.wall_s, time.monotonic(), 0.0
    seeds = range(config.seed, config.seed + config.seeds)
    film = clips.recorder(config, folder.path)
    with (
        progress(config.steps, at.step * config.envs) as show,
        loggers.opened(config.log if spread.is_first() else "none", folder.path, seeds) as log,
    ):
        while not _is_over(config, at) and not spread.any_of(interrupt.requested):
            states, values = program.advance(states, np.int32(at.step))
            at.step += CHUNK_STEPS
            standing.add_up(at, spread.collect(values))
            at.wall_s = time.monotonic() - began
            if at.step % evaluation_period(config) == 0 or at.step == total_steps(config):
                _evaluate(config, program, states, at, folder)
                log()
                film(states.agent.actor, at.step * config.envs)
            show(at.step * config.envs, at.success)
            due = spread.is_first() and save_is_due(save_s, time.monotonic() - saved_at)
            if spread.any_of(due) and not _is_over(config, at):
                save_s = _save(folder, states, at)
                saved_at = time.monotonic()
        at.wall_s = time.monotonic() - began
        _save(folder, states, at)
        policy.save(folder.path, spread.collect(states.agent.actor))
    if not _is_over(config, at):
        say(f"stopped at {at.step * config.envs} steps, saved; go on with the same command:")
        say(f"  {_command()}")
        return STOPPED
    curves.plot({config.algorithm: folder.metrics}, folder.curves)
    say(f"curves    {folder.curves}")
    met = troubles.words(metrics.read(folder.metrics))
    if met:
        say(f"physics   {met}")
    came_to = outcome.judge(config, at.success, at.diverged, at.wall_s)
    say(came_to.line)
    return came_to.code


def save_is_due(save_s: float, since_s: float) -> bool:
    """Whether to save again `since_s` after a save that took `save_s`; the first is due at once."""
    return save_s < _SAVE_SHARE * since_s


def _is_over(config: Config, at: Standing) -> bool:
    return at.step >= total_steps(config) or len(at.diverged) == config.seeds


def _start_or_resume(config, program, folder) -> tuple[TrainState, Standing]:
    found = checkpoints.restore(folder.checkpoints, jax.eval_shape(program.start))
    if spread.any_of(found is not None):
        state, extra = _told(program, found)
        at = standing.from_saved(extra)
        metrics.truncate(folder.metrics, at.step * config.envs)
        say(f"resumed at {at.step * config.envs} of {config.steps} steps")
        return spread.place(state, program.mesh), at
    metrics.truncate(folder.metrics, 0)
    began = time.monotonic()
    states = jax.block_until_ready(program.start())
    took = time.monotonic() - began
    say(f"prepared  {config.algorithm} for {config.seeds} seeds in {took:.1f} s")
    return states, Standing()


def _told(program: Program, found: checkpoints.Checkpoint | None) -> tuple[TrainState, dict]:
    """What the first process found in the run folder, in every process."""
    if jax.process_count() == 1 and found is not None:
        return found.state, found.extra
    blank = spread.collect(program.start())
    state = spread.from_first(found.state if found else blank)
    return state, json.loads(spread.text_from_first(json.dumps(found.extra if found else {})))


def _compiled(program: Program, states: TrainState) -> Program:
    say("compiling one chunk of training steps and the evaluation ...")
    began = time.monotonic()
    advance = program.advance.lower(states, np.int32(0)).compile()
    evaluate = program.evaluate.lower(states.agent.actor, np.int32(0)).compile()
    say(f"compiled  in {time.monotonic() - began:.1f} s")
    return program._replace(advance=advance, evaluate=evaluate)


def _evaluate(config, program, states, at: Standing, folder) -> None:
    """Plays fresh episodes, looks for seeds that diverged, and writes a row for each seed."""
    env_steps = at.step * config.envs
    played = spread.collect(program.evaluate(states.agent.actor, np.int32(env_steps)))
    at.success = np.asarray(played.success).mean(axis=1).tolist()
    for index, place in divergence.find(spread.collect(states.agent), at.sums).items():
        seed = config.seed + index
        if str(seed) not in at.diverged:
            whole = spread.collect(states)
            divergence.keep(folder.path, whole, index, seed, env_steps, place)
            at.diverged[str(seed)] = env_steps
    lengths = np.asarray(played.length).mean(axis=1).tolist()
    metrics.append(folder.metrics, standing.rows(config, at, lengths))
    at.sums, at.chunks = {}, 0


def _save(folder, states: TrainState, at: Standing) -> float:
    began, whole = time.monotonic(), spread.collect(states)
    if spread.is_first():
        checkpoints.save(folder.checkpoints, at.step, whole, dataclasses.asdict(at))
    return time.monotonic() - began


@contextlib.contextmanager
def _place(config: Config) -> Iterator[str]:
    """The run folder of the first process; the others are silent and leave nothing."""
    if spread.is_first():
        yield config.out
        return
    with (
        tempfile.TemporaryDirectory() as scratch,
        open(os.devnull, "w", encoding="utf-8") as nowhere,
        contextlib.redirect_stdout(nowhere),
    ):
        yield scratch


@contextlib.contextmanager
def _memory_reported(folder: artefacts.RunFolder) -> Iterator[None]:
    try:
        yield
    except (MemoryError, jax.errors.JaxRuntimeError) as error:
        if isinstance(error, jax.errors.JaxRuntimeError) and "RESOURCE_EXHAUSTED" not in str(error):
            raise
        raise UserError(
            f"{folder.path}: out of memory ({str(error)[:80]}); free some and run the same command "
            "again, or lower --seeds, --envs or --replay.capacity with another --out",
            STOPPED if any(folder.checkpoints.iterdir()) else USAGE,
        ) from error


def _command() -> str:
    module = getattr(sys.modules["__main__"], "__spec__", None)
    program = ["python", "-m", module.name] if module else ["python", sys.argv[0]]
    return shlex.join([*program, *sys.argv[1:]])
