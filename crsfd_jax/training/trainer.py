"""The host's side of a run: compile, advance, evaluate, record, save, stop, resume.

Runs that share a program go through it side by side; one is the usual case.
"""

import contextlib
import json
import os
import shlex
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax import algorithms
from crsfd_jax.config import Config, to_dict
from crsfd_jax.demos.dataset import Demonstrations, check_units
from crsfd_jax.errors import STOPPED, USAGE, UserError
from crsfd_jax.interrupt import Interrupt
from crsfd_jax.options.run_name import default_folder
from crsfd_jax.options.schedule import (
    CHUNK_STEPS,
    evaluation_period,
    total_env_steps,
    total_steps,
)
from crsfd_jax.options.stored import from_dict
from crsfd_jax.physics.interface import CONTROL_DT
from crsfd_jax.progress import progress, say
from crsfd_jax.storage import artefacts, metrics
from crsfd_jax.storage.leaves import stored_bytes
from crsfd_jax.storage.run_folder import RunFolder
from crsfd_jax.training import bookkeeping, devices, standing
from crsfd_jax.training.bookkeeping import Run
from crsfd_jax.training.program import Program, build, compiled, fitted
from crsfd_jax.training.standing import Standing
from crsfd_jax.training.train_step import TrainState

_SAVE_SHARE = 0.02
"""Largest share of the wall time that saving may take."""


def train(configs: Sequence[Config], demos: Demonstrations) -> int:
    """Runs or continues runs to their end, or until a signal stops them; returns the exit code.

    Args:
      configs: of a run, or of several that `together.require_alike` lets share a program.

    Raises:
      UserError: a run cannot start or go on: demonstrations, options, folder, disk, memory, engine.
    """
    for config in configs:
        check_units(demos, config.mdp.action_scale, CONTROL_DT)
        algorithms.refuse_unused(config)
    asked, configs = configs, _fitted(configs)
    words = devices.describe(configs[0])
    with _places(configs) as paths, contextlib.ExitStack() as stack:
        folders = [
            stack.enter_context(artefacts.open_run(path, config, words, sys.argv))
            for path, config in zip(paths, configs, strict=True)
        ]
        interrupt = stack.enter_context(Interrupt())
        stack.enter_context(_memory_reported(folders))
        program = build(configs, demos)
        size = stored_bytes(jax.eval_shape(program.start, program.own))
        seeds = sum(config.seeds for config in configs)
        for folder in folders:  # They may lie on one disk.
            artefacts.refuse_full_disk(folder, size)
        say(f"device    {words}")
        if jax.device_count() > 1:
            where = f"{program.mesh.size} of {jax.device_count()} devices"
            say(f"seeds     {seeds}, evenly on {where}, {jax.process_count()} processes")
        for config, folder in zip(configs, folders, strict=True):
            shift = f"{config.shift * 1e3:g} mm"
            say(f"task      shape {config.shape}, shift {shift}, {config.algorithm}")
            say(f"folder    {folder.path}")
        say(f"buffer    {_buffer(configs[0], asked[0])}, {size / 1e6:.0f} MB in all")
        period = evaluation_period(configs[0]) * configs[0].envs
        say(f"steps     {total_env_steps(configs[0])} a seed, evaluated every {period}")
        return run(configs, program, folders, interrupt)


def run(
    configs: Sequence[Config],
    program: Program,
    folders: Sequence[RunFolder],
    interrupt: Interrupt,
) -> int:
    """Starts or resumes, and goes on to the end or to a signal; returns the exit code."""
    states, runs = _start_or_resume(configs, program, folders)
    first = runs[0]
    save_s = 0.0
    with contextlib.ExitStack() as stack:
        watchers = [bookkeeping.watcher(each, stack) for each in runs]
        if not _are_over(runs):
            program = _compiled(program, states)
        show = stack.enter_context(progress(total_env_steps(first.config), first.env_steps))
        clock = saved_at = time.monotonic()
        while not _are_over(runs) and not devices.any_of(interrupt.requested):
            step = first.at.step + CHUNK_STEPS
            states, values = program.advance(states, program.own, np.int32(first.at.step))
            values = devices.collect(values)
            for each in runs:
                bookkeeping.add_up(each, step, values)
            clock = bookkeeping.share_time(runs, clock)
            if step % evaluation_period(first.config) == 0 or step == total_steps(first.config):
                agent = devices.collect(states.agent)
                actor, at = states.agent.average_actor, np.int32(first.env_steps)
                played = program.evaluate(actor, program.own, at)
                played = devices.collect(played)
                for each, watch in zip(runs, watchers, strict=True):
                    bookkeeping.evaluated(each, states, agent, played)
                    watch(agent.average_actor)
            show(first.env_steps, [rate for each in runs for rate in each.at.success])
            due = devices.is_first() and save_is_due(save_s, time.monotonic() - saved_at)
            if devices.any_of(due) and not _are_over(runs):
                save_s = _save(runs, states)
                saved_at = time.monotonic()
        bookkeeping.share_time(runs, clock)
        _save(runs, states)
    if not _are_over(runs):
        say(f"stopped at {first.env_steps} steps, saved; go on with the same command:")
        say(f"  {_command()}")
        return STOPPED
    return max([bookkeeping.conclude(each) for each in runs])


def save_is_due(save_s: float, since_s: float) -> bool:
    """Whether to save again `since_s` after a save that took `save_s`; the first is due at once."""
    return save_s < _SAVE_SHARE * since_s


def _fitted(configs: Sequence[Config]) -> list[Config]:
    """With the sizes that follow from what the first process has in the run folders."""
    own = [to_dict(fitted(config, artefacts.begun(default_folder(config)))) for config in configs]
    return [from_dict(each) for each in json.loads(devices.text_from_first(json.dumps(own)))]


def _buffer(config: Config, asked: Config) -> str:
    """The buffer of a run in words; a run that was begun shorter keeps the size that it had."""
    own, fresh = config.replay.capacity, fitted(asked).replay.capacity
    kept = "" if own >= fresh else f" (as the run began; a new one of these steps has {fresh})"
    return f"{own} transitions a seed{kept}"


def _are_over(runs: Sequence[Run]) -> bool:
    finished = runs[0].at.step >= total_steps(runs[0].config)
    return finished or all(each.is_lost for each in runs)


def _start_or_resume(configs, program, folders) -> tuple[TrainState, list[Run]]:
    like = jax.eval_shape(program.start, program.own)
    ends = np.cumsum([config.seeds for config in configs]).tolist()
    seeds = [slice(end - config.seeds, end) for config, end in zip(configs, ends, strict=True)]
    parts = [None] if len(configs) == 1 else seeds
    found = bookkeeping.restored(folders, parts, like)
    if devices.any_of(found[0] is not None):
        states, extras = _told(program, found)
        ats = [standing.from_saved(extra) for extra in extras]
        states = devices.place(states, program.mesh)
    else:
        states, ats = None, [Standing() for _ in configs]
    runs = [Run(*each) for each in zip(configs, folders, parts, ats, strict=True)]
    for each in runs:
        metrics.truncate(each.folder.metrics, each.env_steps)
    if states is not None:
        say(f"resumed at {runs[0].env_steps} of {total_env_steps(configs[0])} steps")
        return states, runs
    began = time.monotonic()
    states = jax.block_until_ready(program.start(program.own))
    took = time.monotonic() - began
    say(f"prepared  {configs[0].algorithm} for {ends[-1]} seeds in {took:.1f} s")
    return states, runs


def _told(program: Program, found: Sequence) -> tuple[TrainState, list[dict]]:
    """What the first process found in the run folders, in every process."""
    if jax.process_count() > 1:
        # Also in the first one: all must collect, or none.
        blank = devices.collect(program.start(program.own))
    if found[0] is None:
        states, extras = blank, []
    elif len(found) == 1:
        states, extras = found[0].state, [found[0].extra]
    else:
        states = jax.tree.map(lambda *x: jnp.concatenate(x), *(each.state for each in found))
        extras = [each.extra for each in found]
    return devices.from_first(states), json.loads(devices.text_from_first(json.dumps(extras)))


def _compiled(program: Program, states: TrainState) -> Program:
    say("compiling one chunk of training steps and the evaluation ...")
    began = time.monotonic()
    ready = compiled(program, states)
    say(f"compiled  in {time.monotonic() - began:.1f} s")
    return ready


def _save(runs: Sequence[Run], states: TrainState) -> float:
    began, whole = time.monotonic(), devices.collect(states)
    if devices.is_first():
        for each in runs:
            bookkeeping.save(each, whole)
    return time.monotonic() - began


@contextlib.contextmanager
def _places(configs: Sequence[Config]) -> Iterator[list[str]]:
    """The run folders of the first process; the others are silent and leave nothing."""
    if devices.is_first():
        yield [config.out for config in configs]
        return
    with (
        tempfile.TemporaryDirectory() as scratch,
        open(os.devnull, "w", encoding="utf-8") as nowhere,
        contextlib.redirect_stdout(nowhere),
    ):
        yield [f"{scratch}/{i}" for i in range(len(configs))]


@contextlib.contextmanager
def _memory_reported(folders: Sequence[RunFolder]) -> Iterator[None]:
    try:
        yield
    except (MemoryError, jax.errors.JaxRuntimeError) as error:
        if isinstance(error, jax.errors.JaxRuntimeError) and "RESOURCE_EXHAUSTED" not in str(error):
            raise
        raise UserError(
            f"{folders[0].path}: out of memory ({str(error)[:80]}); free some and run the same "
            "command again, train runs that are together apart, or lower --seeds, --envs or "
            "--replay.capacity with another --out",
            STOPPED if any(folders[0].checkpoints.iterdir()) else USAGE,
        ) from error


def _command() -> str:
    module = getattr(sys.modules["__main__"], "__spec__", None)
    program = ["python", "-m", module.name] if module else ["python", sys.argv[0]]
    return shlex.join([*program, *sys.argv[1:]])
