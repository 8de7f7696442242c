"""Cells run to their end in a process, tried again where that may help."""

import contextlib
import functools
import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple

from crsfd_jax.errors import DONE, STOPPED, USAGE
from crsfd_jax.options import together
from crsfd_jax.storage import run_folder
from crsfd_jax.sweeps import state
from crsfd_jax.sweeps.cells import Cell

TRAIN = (sys.executable, "-m", "crsfd_jax.train")
EVALUATE = (sys.executable, "-m", "crsfd_jax.evaluate")
_POLL_S = 0.2


class Plan(NamedTuple):
    """What is the same for all cells of a sweep."""

    out: Path
    """Absolute; on several machines, a folder that they share."""
    command: tuple[str, ...] = TRAIN
    """What a cell's arguments are given to."""
    retries: int = 1
    environment: tuple[tuple[str, str], ...] = ()
    """Variables that a run gets besides those of the sweep."""


class CellResult(NamedTuple):
    """What became of a cell."""

    name: str
    word: Literal["done", "failed", "stopped", "busy"]
    """Busy: another sweep has it."""
    tail: tuple[str, ...] = ()
    """Last lines of the log of a cell that failed."""


Group = tuple[Cell, ...]
"""Cells that share a process and, where they are several, a program."""
Stopping = Callable[[], bool]


def run_group(group: Group, plan: Plan, stopping: Stopping = lambda: False) -> list[CellResult]:
    """Runs or continues cells, but for those that are finished or that somebody else has.

    Several are tried together once; whatever goes wrong then, each goes on by itself.

    Args:
      stopping: asked several times a second; once it is true, the runs save and end.
    """
    try:
        return _run_group(group, plan, stopping)
    except OSError as error:
        # Of a full disk or a log that cannot be opened; other groups go on.
        return [CellResult(cell.name, "failed", (str(error),)) for cell in group]


def _run_group(group: Group, plan: Plan, stopping: Stopping) -> list[CellResult]:
    plan.out.mkdir(parents=True, exist_ok=True)
    outcomes: list[CellResult] = []
    logs: dict[Cell, BinaryIO] = {}
    with contextlib.ExitStack() as stack:
        for cell in group:
            if state.is_done(plan.out, cell):
                outcomes.append(CellResult(cell.name, "done"))
                continue
            log = stack.enter_context(state.claimed(state.log_path(plan.out, cell)))
            if log is not None and not _is_held(cell, plan):
                logs[cell] = log
                continue
            outcomes.append(CellResult(cell.name, "busy"))
            if log is not None:
                log.close()
        if len(logs) > 1 and not stopping():
            _run(command_of(logs, plan), logs, plan, "together", stopping)
        for cell, log in logs.items():
            outcomes.append(_run_to_end(cell, log, plan, stopping))
            log.close()
    return outcomes


def _run_to_end(cell: Cell, log: BinaryIO, plan: Plan, stopping: Stopping) -> CellResult:
    """Trains a cell, then plays its trials; each is tried again if it fails."""

    def is_trained() -> bool:
        return state.is_finished(plan.out / cell.name, cell.config)

    def has_trials() -> bool:
        return state.has_trials(plan.out, cell)

    persist = functools.partial(_persist, cell, log, plan, stopping)
    outcome = persist(command_of((cell,), plan), is_trained)
    if outcome.word != "done" or has_trials():
        return outcome
    # Others than those that are asked for.
    run_folder.at(plan.out / cell.name).trials.unlink(missing_ok=True)
    return persist(trials_of(cell, plan), has_trials)


def _persist(
    cell: Cell,
    log: BinaryIO,
    plan: Plan,
    stopping: Stopping,
    command: list[str],
    is_done: Callable[[], bool],
) -> CellResult:
    path = state.log_path(plan.out, cell)
    for attempt in range(plan.retries + 1):
        # Another sweep may have finished it before this one had its lock.
        if is_done():
            return CellResult(cell.name, "done")
        if stopping():
            return CellResult(cell.name, "stopped")
        start = path.stat().st_size
        what = f"attempt {attempt + 1} of {plan.retries + 1}"
        code = _run(command, {cell: log}, plan, what, stopping)
        if code == DONE or is_done():
            return CellResult(cell.name, "done")
        if code == STOPPED or stopping():
            return CellResult(cell.name, "stopped")
        if _is_held(cell, plan):
            return CellResult(cell.name, "busy")
        lines = state.tail(path, start)
        if code == USAGE:
            break
    _write(log, f"{state.GAVE_UP} with exit code {code}")
    return CellResult(cell.name, "failed", (*lines, f"exit code {code}"))


def _is_held(cell: Cell, plan: Plan) -> bool:
    return state.is_held(run_folder.at(plan.out / cell.name).lock)


def command_of(group: Iterable[Cell], plan: Plan) -> list[str]:
    """The command that trains cells."""
    words: list[str] = []
    for cell in group:
        words += [together.MARK, *cell.arguments, "--out", str(plan.out / cell.name)]
    return [*plan.command, *words[1:]]


def trials_of(cell: Cell, plan: Plan) -> list[str]:
    """The command that plays the trials of a cell."""
    folder = plan.out / cell.name
    return [*EVALUATE, str(folder), *cell.trials, "--csv", str(run_folder.at(folder).trials)]


def _run(
    command: list[str], logs: dict[Cell, BinaryIO], plan: Plan, what: str, stopping: Stopping
) -> int:
    """One process, from its start to its end; it writes to the first log and holds all."""
    (first, log), *others = logs.items()
    _write(log, f"sweep: {what}: {shlex.join(command)}")
    for _, other in others:
        _write(other, f"sweep: {what} with {first.name}, see its log")
    # In a session of its own, Ctrl-C on a terminal reaches it through `stopping` alone.
    process = subprocess.Popen(
        command,
        env={**os.environ, **dict(plan.environment)},
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
        pass_fds=[other.fileno() for _, other in others],
        start_new_session=True,
    )
    try:
        while not stopping():
            try:
                return process.wait(_POLL_S)
            except subprocess.TimeoutExpired:
                pass
    finally:
        # Also where this process is told to end by an exception, as Ray does it.
        if process.poll() is None:
            process.terminate()
            process.wait()
    return process.returncode


def _write(log: BinaryIO, line: str) -> None:
    log.write(f"{line}\n".encode())
    log.flush()
