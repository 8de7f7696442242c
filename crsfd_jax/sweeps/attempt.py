"""Cells run to their end in a process, tried again where that may help."""

import contextlib
import functools
import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
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
    outcomes: list[CellResult] = []
    logs: dict[Cell, BinaryIO] = {}
    with contextlib.ExitStack() as stack:
        for cell in group:
            with _failing(cell, outcomes):
                if taken := _taken(cell, plan, stack):
                    logs[cell] = taken
                else:
                    word = "done" if state.is_done(plan.out, cell) else "busy"
                    outcomes.append(CellResult(cell.name, word))
        left = {cell: log for cell, log in logs.items() if not _is_trained(cell, plan)}
        if len(left) > 1 and not stopping():
            with contextlib.suppress(OSError):
                _run(command_of(left, plan), left, plan, "together", stopping)
        for cell, log in logs.items():
            with _failing(cell, outcomes):
                outcomes.append(_run_to_end(cell, log, plan, stopping))
            log.close()
    return outcomes


@contextlib.contextmanager
def _failing(cell: Cell, outcomes: list[CellResult]) -> Iterator[None]:
    """A full disk, or a log that cannot be opened, is a cell's own failure; others go on."""
    try:
        yield
    except OSError as error:
        outcomes.append(CellResult(cell.name, "failed", (str(error),)))


def _taken(cell: Cell, plan: Plan, stack: contextlib.ExitStack) -> BinaryIO | None:
    """The log of a cell, locked; None if the cell is done or somebody else has it."""
    if state.is_done(plan.out, cell):
        return None
    plan.out.mkdir(parents=True, exist_ok=True)
    log = stack.enter_context(state.claimed(state.log_path(plan.out, cell)))
    if log is not None and _is_held(cell, plan):
        log.close()
        return None
    return log


def _run_to_end(cell: Cell, log: BinaryIO, plan: Plan, stopping: Stopping) -> CellResult:
    """Trains a cell, then plays its trials; each is tried again if it fails."""

    def is_trained() -> bool:
        return _is_trained(cell, plan)

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


def _is_trained(cell: Cell, plan: Plan) -> bool:
    return state.is_finished(plan.out / cell.name, cell.config)


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
