"""How far a cell is, read from its run folder and its log; nothing here writes."""

import contextlib
import dataclasses
import fcntl
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple

from crsfd_jax.config import Config
from crsfd_jax.errors import UserError
from crsfd_jax.options.names import MAY_CHANGE
from crsfd_jax.options.schedule import total_steps
from crsfd_jax.storage import artefacts, metrics, run_folder, trials
from crsfd_jax.sweeps.cells import Cell

GAVE_UP = "sweep: gave up"
"""Start of the last line in the log of a cell that failed."""

Word = Literal["done", "running", "failed", "stopped", "new", "other"]
"""Other: its folder holds a run with other options."""


class State(NamedTuple):
    """What is known of a cell."""

    word: Word
    env_steps: int = 0
    success: float | None = None
    """Newest success rate, mean over seeds."""
    wall_s: float = 0.0


def log_path(out: Path, cell: Cell) -> Path:
    """The log stands beside the run folder, which only the run itself writes to."""
    return out / f"{cell.name}.log"


def read(out: Path, cell: Cell) -> State:
    """The state of a cell in the folder of its sweep."""
    folder, log = out / cell.name, log_path(out, cell)
    state = _measured(folder)
    if is_held(log) or is_held(run_folder.at(folder).lock):
        return state._replace(word="running")
    if is_done(out, cell):
        return state._replace(word="done")
    if _is_other(folder, cell.config):
        return state._replace(word="other")
    last = tail(log, lines=1)
    if last and last[0].startswith(GAVE_UP):
        return state._replace(word="failed")
    return state._replace(word="stopped" if folder.exists() else "new")


def is_done(out: Path, cell: Cell) -> bool:
    """Whether a cell is trained and has had its trials."""
    return is_finished(out / cell.name, cell.config) and has_trials(out, cell)


def has_trials(out: Path, cell: Cell) -> bool:
    """Whether the trials of a cell, those that it asks for, have been played."""
    if not cell.trials:
        return True
    try:
        rows = trials.read(run_folder.at(out / cell.name).trials)
    except UserError:
        return False
    return bool(rows) and all(row.options == cell.asked for row in rows)


def is_finished(folder: Path, config: Config) -> bool:
    """Whether a folder holds this run, evaluated at its last step, with the policy of that step."""
    run = run_folder.at(folder)
    try:
        same = _same_run(artefacts.read_config(folder), config)
        env_steps = metrics.read(run.metrics)["env_steps"]
    except UserError:
        return False
    evaluated = (env_steps >= config.steps).sum() >= config.seeds
    # A policy is written at every evaluation; that of the end, before its checkpoint.
    saved = max(artefacts.saved_steps(run.checkpoints), default=total_steps(config))
    final = saved * config.envs >= config.steps and run.policy.is_file()
    return bool(same and evaluated and final)


def is_held(path: Path) -> bool:
    """Whether a process holds the lock of a file."""
    try:
        with path.open("rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except FileNotFoundError:
        return False
    return False


@contextlib.contextmanager
def claimed(path: Path) -> Iterator[BinaryIO | None]:
    """Opens a log to append to and locks it; None where somebody else has it.

    A child that inherits it keeps the lock when this process dies, so that nobody starts the
    same cell beside an orphan.
    """
    with path.open("ab") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield None
            return
        yield stream


def tail(log: Path, start: int = 0, lines: int = 5) -> list[str]:
    """The last lines of a log that are not empty, from a byte on."""
    if not log.is_file():
        return []
    with log.open("rb") as stream:
        stream.seek(max(start, log.stat().st_size - 4096))
        text = stream.read().decode(errors="replace")
    return [line for line in text.splitlines() if line.strip()][-lines:]


def _measured(folder: Path) -> State:
    try:
        table = metrics.read(run_folder.at(folder).metrics)
    except UserError:
        return State("new")
    if not len(table["env_steps"]):
        return State("new")
    last = table["env_steps"] == table["env_steps"].max()
    success = float(table["eval/success_rate"][last].mean())
    return State("new", int(table["env_steps"].max()), success, float(table["time/wall_s"].max()))


def _is_other(folder: Path, config: Config) -> bool:
    try:
        begun = artefacts.begun(folder)
    except UserError:
        return False
    return begun is not None and not _same_run(begun, config)


def _same_run(found: Config, config: Config) -> bool:
    # What a run may change when it goes on, and the buffer, which it fits to its length.
    given = {name: getattr(config, name) for name in ("steps", *MAY_CHANGE)}
    replay = dataclasses.replace(found.replay, capacity=config.replay.capacity)
    return dataclasses.replace(found, replay=replay, **given) == config
