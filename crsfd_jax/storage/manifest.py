"""config.json: what a run is made of, and what with."""

import contextlib
import datetime
import json
import platform
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from crsfd_jax.config import Config, to_dict
from crsfd_jax.errors import UserError
from crsfd_jax.options.stored import from_dict
from crsfd_jax.storage.files import write_text

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


class Manifest(NamedTuple):
    """What describes a run."""

    config: Config
    versions: dict[str, str]
    device: str
    """What it computed on at its start, in words."""
    started: str = ""
    """UTC, ISO 8601."""
    command: Sequence[str] = ()


def now(config: Config, device: str, command: Sequence[str]) -> Manifest:
    """That of a run which starts now."""
    started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return Manifest(config, versions(), device, started, command)


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide what a run computes."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def write(path: Path, manifest: Manifest) -> None:
    """Writes it, all or nothing."""
    told = manifest._asdict() | {"config": to_dict(manifest.config)}
    text = json.dumps(told, indent=2) + "\n"
    write_text(path, text)


def read(path: Path) -> Manifest:
    """Reads what `write` wrote, also of an older version.

    Raises:
      UserError: the file cannot be read, is no such description, or has options or values that
        this version does not know.
    """
    try:
        told = json.loads(path.read_bytes())
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}; check the name") from error
    except ValueError as error:
        raise UserError(
            f"{path}: is damaged ({error}); copy it back or use another folder"
        ) from error
    if not _is_description(told):
        raise UserError(f"{path}: is not the description of a run; use another folder")
    try:
        config = from_dict(told["config"])
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    return Manifest(config, **{k: told[k] for k in Manifest._fields[1:] if k in told})


def _is_description(told: Any) -> bool:
    kinds = {"config": dict, "versions": dict, "device": str, "started": str, "command": list}
    return (
        isinstance(told, dict)
        and all(told.get(part) for part in ("config", "versions", "device"))
        and all(isinstance(told[part], kind) for part, kind in kinds.items() if part in told)
    )
