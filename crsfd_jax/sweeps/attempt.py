"""A cell run to its end in a process of its own, tried again where that may help."""

import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple

from crsfd_jax import artefacts
from crsfd_jax.errors import DONE, STOPPED, USAGE
from crsfd_jax.sweeps import state
from crsfd_jax.sweeps.cells import Cell

TRAIN = (sys.executable, "-m", "crsfd_jax.train")
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


class Outcome(NamedTuple):
    """What became of a cell."""

    name: str
    word: Literal["done", "failed", "stopped", "busy"]
    """Busy: another sweep has it."""
    tail: tuple[str, ...] = ()
    """Last lines of the log of a cell that failed."""


def run_cell(cell: Cell, plan: Plan, stopping: Callable[[], bool] = lambda: False) -> Outcome:
    """Runs or continues a cell, unless it is finished or somebody else has it.

    Args:
      stopping: asked several times a second; once it is true, the run saves and ends.
    """
    plan.out.mkdir(parents=True, exist_ok=True)
    folder, log = plan.out / cell.name, state.log_path(plan.out, cell)
    if state.is_finished(folder, cell.config):
        return Outcome(cell.name, "done")
    with state.claimed(log) as stream:
        if stream is None or state.is_held(folder / artefacts.LOCK):
            return Outcome(cell.name, "busy")
        for attempt in range(plan.retries + 1):
            # Another sweep may have finished it before this one had its lock.
            if state.is_finished(folder, cell.config):
                return Outcome(cell.name, "done")
            if stopping():
                return Outcome(cell.name, "stopped")
            start = log.stat().st_size
            code = _run(cell, plan, attempt, stream, stopping)
            if code == DONE or state.is_finished(folder, cell.config):
                return Outcome(cell.name, "done")
            if code == STOPPED or stopping():
                return Outcome(cell.name, "stopped")
            if state.is_held(folder / artefacts.LOCK):
                return Outcome(cell.name, "busy")
            lines = state.tail(log, start)
            if code == USAGE:
                break
        _write(stream, f"{state.GAVE_UP} with exit code {code}")
    return Outcome(cell.name, "failed", (*lines, f"exit code {code}"))


def _run(cell: Cell, plan: Plan, attempt: int, log: BinaryIO, stopping: Callable[[], bool]) -> int:
    """One process, from its start to its end."""
    command = [*plan.command, *cell.arguments, "--out", str(plan.out / cell.name)]
    _write(log, f"sweep: attempt {attempt + 1} of {plan.retries + 1}: {shlex.join(command)}")
    # In a session of its own, Ctrl-C on a terminal reaches it through `stopping` alone.
    process = subprocess.Popen(
        command,
        env={**os.environ, **dict(plan.environment)},
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
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
