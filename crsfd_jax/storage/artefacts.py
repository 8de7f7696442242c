"""The run folder while it is used: one owner at a time, one run, and room on its disk."""

import contextlib
import datetime
import errno
import fcntl
import logging
import os
import re
import shutil
import socket
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TextIO

from crsfd_jax.config import Config
from crsfd_jax.errors import STOPPED, USAGE, UserError
from crsfd_jax.options.limits import differences
from crsfd_jax.options.names import MAY_CHANGE
from crsfd_jax.storage import manifest, run_folder
from crsfd_jax.storage.files import remove_leftovers, sync
from crsfd_jax.storage.manifest import Manifest
from crsfd_jax.storage.run_folder import RunFolder

KEPT = 2
"""Checkpoints that are kept; one more exists while it is being written."""

_STORAGE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
"""What is wrong with a disk; such errors of an open file name no file."""
_TRIES, _BETWEEN_S = 10, 0.02
_log = logging.getLogger(__name__)


@contextlib.contextmanager
def open_run(
    path: str | Path, config: Config, device: str, command: Sequence[str]
) -> Iterator[RunFolder]:
    """Creates a run folder, or reopens that of the same run; it is ours while the block lasts.

    Args:
      device: what the run computes on, in words.

    Raises:
      UserError: another process runs in it, it holds something else or a run with other
        options, or it cannot be written, also later in the block.
    """
    path = Path(path).absolute()
    run = run_folder.at(path)
    what_to_do, code = "choose another --out", USAGE
    try:
        _refuse_foreign(run)
        path.mkdir(parents=True, exist_ok=True)
        with _locked(run):
            remove_leftovers(path)
            _record(run, manifest.now(config, device, command))
            run.checkpoints.mkdir(exist_ok=True)
            sync(path)
            what_to_do, code = "put it right and run the same command again", STOPPED
            yield run
    except OSError as error:
        if not _is_about(path, error):
            raise
        raise UserError(
            f"{path}: cannot be written: {error.strerror}; {what_to_do}", code
        ) from error


def begun(path: str | Path) -> Config | None:
    """The options of the run in a folder if it has left anything to go on from.

    Raises:
      UserError: its description is damaged.
    """
    return read_config(path) if _has_begun(run_folder.at(path)) else None


def read_config(path: str | Path) -> Config:
    """The options of the run in a folder.

    Raises:
      UserError: the folder holds no run.
    """
    return _described(run_folder.at(path)).config


def refuse_full_disk(run: RunFolder, checkpoint_bytes: int) -> None:
    """Checks that the disk has room for the checkpoints that are kept.

    Raises:
      UserError: it has not.
    """
    present = len(list(run.checkpoints.iterdir())) if run.checkpoints.exists() else 0
    needed = checkpoint_bytes * max(1, KEPT + 1 - present)
    free = shutil.disk_usage(run.path).free
    if free < needed:
        raise UserError(
            f"{run.path}: the disk has {free / 1e6:.0f} MB free, expected {needed / 1e6:.0f} MB "
            "for checkpoints; free some, choose another --out or lower --replay.capacity"
        )


def saved_steps(checkpoints: Path) -> list[int]:
    """Vector steps with a checkpoint, newest first."""
    names = (entry.name for entry in checkpoints.glob("*") if entry.is_dir())
    return sorted((int(n) for n in names if re.fullmatch("0|[1-9][0-9]*", n)), reverse=True)


def _is_about(path: Path, error: OSError) -> bool:
    if error.filename is None:
        return error.errno in _STORAGE
    place = Path(os.fsdecode(error.filename))
    return place.is_relative_to(path) or path.is_relative_to(place)


def _refuse_foreign(run: RunFolder) -> None:
    path = run.path
    if path.exists() and not path.is_dir():
        raise UserError(f"{path}: is a file; choose another --out")
    found = {entry.name for entry in path.iterdir()} if path.exists() else set()
    if found and not found & {run.lock.name, run.config.name}:
        raise UserError(
            f"{path}: holds other files ({min(found)}), expected a new folder or a run; "
            "choose another --out"
        )
    if run.config.name in found:
        manifest.read(run.config)


@contextlib.contextmanager
def _locked(run: RunFolder) -> Iterator[None]:
    # The kernel frees the lock when its owner dies in any way, so a stale file is harmless.
    with run.lock.open("a+", encoding="utf-8") as lock:
        try:
            _lock(lock)
        except BlockingIOError:
            lock.seek(0)
            owner = lock.read().strip() or "another process"
            raise UserError(
                f"{run.path}: in use by {owner}; wait for it or choose another --out"
            ) from None
        lock.truncate(0)
        now = datetime.datetime.now().isoformat(timespec="seconds")
        lock.write(f"process {os.getpid()} on {socket.gethostname()} since {now}")
        lock.flush()
        yield


def _lock(file: TextIO) -> None:
    """Locks a file; who only looks whether it is locked has it for an instant."""
    for _ in range(_TRIES - 1):
        with contextlib.suppress(BlockingIOError):
            return fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        time.sleep(_BETWEEN_S)
    return fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _has_begun(run: RunFolder) -> bool:
    return run.metrics.exists() or any(run.checkpoints.glob("*"))


def _described(run: RunFolder) -> Manifest:
    if not run.config.is_file():
        raise UserError(
            f"{run.path}: holds no {run.config.name}, expected the folder of a run; check the name"
        )
    return manifest.read(run.config)


def _record(run: RunFolder, new: Manifest) -> None:
    """Describes the run in its folder; if it has begun, it must be the same."""
    if _has_begun(run):
        old = _described(run)
        _refuse_other_run(run.path, old.config, new.config)
        for name in ("versions", "device"):
            if getattr(old, name) != getattr(new, name):
                _log.warning(
                    "%s: started with other %s, so not bit-equal from here on: %s, now %s",
                    *(run.path, name, getattr(old, name), getattr(new, name)),
                )
        new = old._replace(config=new.config)
    manifest.write(run.config, new)


def _refuse_other_run(path: Path, old: Config, new: Config) -> None:
    changed = [
        f"{name} {before} -> {after}"
        for name, (before, after) in differences(old, new).items()
        if name not in MAY_CHANGE and (name != "steps" or new.steps < old.steps)
    ]
    if changed:
        free = ", ".join(f"--{name}" for name in MAY_CHANGE if name != "out")
        raise UserError(
            f"{path}: holds a run with other options: {', '.join(changed)}; use its "
            f"options (--steps may grow; {free} may change) or another --out"
        )
