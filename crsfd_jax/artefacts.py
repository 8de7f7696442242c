"""The run folder: one owner at a time, what the run is made of, and where things lie in it.

config.json     every option, the versions, the device and the command line
metrics.csv     one row for each evaluation of each seed
checkpoints/    the newest complete states of the run
policy.npz      parameters of the trained policies
curves.png      success against environment steps
clips/          films of the policy, if asked for
"""

import contextlib
import datetime
import errno
import fcntl
import json
import logging
import os
import platform
import re
import shutil
import socket
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from crsfd_jax.config import Config, from_dict, to_dict
from crsfd_jax.errors import STOPPED, USAGE, UserError
from crsfd_jax.files import remove_leftovers, sync, write_atomically
from crsfd_jax.option_names import by_full_name

PACKAGES = (
    "jax",
    "jaxlib",
    "mujoco",
    "mujoco-mjx",
    "flax",
    "optax",
    "orbax-checkpoint",
    "crsfd-jax",
)
COPIES = 3
"""Checkpoints that exist at once: two kept and one being written."""

LOCK, _CONFIG = ".lock", "config.json"
_METRICS, _CHECKPOINTS = "metrics.csv", "checkpoints"
MAY_CHANGE = ("out", "engine", "target", "log", "clips")
"""Options that a continued run may give anew; --steps may grow."""
_STORAGE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
"""What is wrong with a disk; such errors of an open file name no file."""
_log = logging.getLogger(__name__)


class RunFolder(NamedTuple):
    """Where the parts of a run lie."""

    path: Path
    metrics: Path
    checkpoints: Path
    curves: Path


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
    run = RunFolder(path, path / _METRICS, path / _CHECKPOINTS, path / "curves.png")
    what_to_do, code = "choose another --out", USAGE
    try:
        _refuse_foreign(path)
        path.mkdir(parents=True, exist_ok=True)
        with _locked(path):
            remove_leftovers(path)
            _record(path, _manifest(config, device, command))
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
    return read_config(path) if _has_begun(Path(path)) else None


def read_config(path: str | Path) -> Config:
    """The options of the run in a folder.

    Raises:
      UserError: the folder holds no run.
    """
    return from_dict(_read_manifest(path)["config"])


def refuse_full_disk(run: RunFolder, checkpoint_bytes: int) -> None:
    """Checks that the disk has room for the checkpoints that are kept.

    Raises:
      UserError: it has not.
    """
    present = len(list(run.checkpoints.iterdir())) if run.checkpoints.exists() else 0
    needed = checkpoint_bytes * max(1, COPIES - present)
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


def _refuse_foreign(path: Path) -> None:
    if path.exists() and not path.is_dir():
        raise UserError(f"{path}: is a file; choose another --out")
    found = {entry.name for entry in path.iterdir()} if path.exists() else set()
    if found and not found & {LOCK, _CONFIG}:
        raise UserError(
            f"{path}: holds other files ({min(found)}), expected a new folder or a run; "
            "choose another --out"
        )
    if _CONFIG in found:
        _read_manifest(path)


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    # The kernel frees the lock when its owner dies in any way, so a stale file is harmless.
    with (path / LOCK).open("a+", encoding="utf-8") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.seek(0)
            owner = lock.read().strip() or "another process"
            raise UserError(
                f"{path}: in use by {owner}; wait for it or choose another --out"
            ) from None
        lock.truncate(0)
        now = datetime.datetime.now().isoformat(timespec="seconds")
        lock.write(f"process {os.getpid()} on {socket.gethostname()} since {now}")
        lock.flush()
        yield


def _manifest(config: Config, device: str, command: Sequence[str]) -> dict[str, Any]:
    return {
        "config": to_dict(config),
        "versions": versions(),
        "device": device,
        "command": list(command),
        "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide what a run computes."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def _has_begun(path: Path) -> bool:
    return (path / _METRICS).exists() or any((path / _CHECKPOINTS).glob("*"))


def _record(path: Path, manifest: dict[str, Any]) -> None:
    """Describes the run in its folder; if it has begun, it must be the same."""
    if _has_begun(path):
        old = _read_manifest(path)
        _refuse_other_run(path, old["config"], _as_json(manifest["config"]))
        for name in ("versions", "device"):
            if old[name] != manifest[name]:
                _log.warning(
                    "%s: started with other %s, so not bit-equal from here on: %s, now %s",
                    *(path, name, old[name], manifest[name]),
                )
        manifest = old | {"config": manifest["config"]}
    text = json.dumps(manifest, indent=2) + "\n"
    write_atomically(path / _CONFIG, lambda stream: stream.write(text.encode()))


def _read_manifest(path: str | Path) -> dict[str, Any]:
    """What describes the run in a folder."""
    file = Path(path) / _CONFIG
    if not file.is_file():
        raise UserError(f"{path}: holds no {_CONFIG}, expected the folder of a run; check the name")
    try:
        manifest = json.loads(file.read_bytes())
    except ValueError as error:
        raise UserError(
            f"{file}: is damaged ({error}); copy it back or use another folder"
        ) from error
    parts = ("config", "versions", "device")
    if not isinstance(manifest, dict) or not all(manifest.get(part) for part in parts):
        raise UserError(f"{file}: is not the description of a run; use another folder")
    return manifest


def _refuse_other_run(path: Path, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    before, after = by_full_name(_as_json(to_dict(from_dict(old)))), by_full_name(new)
    changed = [
        f"{name} {before[name]} -> {after[name]}"
        for name in after
        if before[name] != after[name] and name not in MAY_CHANGE
        if name != "steps" or after[name] < before[name]
    ]
    if changed:
        free = ", ".join(f"--{name}" for name in MAY_CHANGE if name != "out")
        raise UserError(
            f"{path}: holds a run with other options: {', '.join(changed)}; use its "
            f"options (--steps may grow; {free} may change) or another --out"
        )


def _as_json(values: Mapping[str, Any]) -> dict[str, Any]:
    return json.loads(json.dumps(values))
