"""Where demonstrations come from, as JSON text inside their file."""

import dataclasses
import json
import typing
from dataclasses import dataclass
from typing import Any

import numpy as np

from crsfd_jax.config import Scene
from crsfd_jax.errors import UserError
from crsfd_jax.observation import OBSERVATION
from crsfd_jax.options import limits, shapes, validation
from crsfd_jax.options.field_types import LARGEST_SHIFT

SCHEMA = 1


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Where demonstrations come from and what their columns mean."""

    schema: int = SCHEMA
    """Version of the file's layout."""
    shape: str
    """Of the peg and its socket: a digit, or a name and a grid, as `options.shapes` writes it."""
    clearance_m: float
    shift_m: float
    """Side of the square in which the socket's offset was drawn."""
    control_dt_s: float
    obs_layout: list[list[str]]
    """A [name, unit] for each column of obs."""
    action_scale: list[float]
    """Displacement for an action of 1, m or rad, for each column of action."""
    expert: str
    """What chose the actions, in words."""
    expert_success_rate: float
    """Share of attempts with this noise that succeeded, none of them recorded; of a person, of the
    recorded ones."""
    noise: float
    """Factor of the noise added to the expert's actions."""
    seed: int
    command: str
    """Command line that recorded the file."""
    versions: dict[str, str]
    """Package name -> version."""
    date: str
    """ISO 8601."""


def obs_layout() -> list[list[str]]:
    """A [name, unit] for each column of this package's observations."""
    return [
        [f"{name}_{i}", f"{unit}, divided by {scale:g}"]
        for name, size, unit, scale in OBSERVATION
        for i in range(size)
    ]


def check_columns(source: Provenance, obs_dim: int, action_dim: int) -> None:
    """Checks that columns are named, as many as there are.

    Raises:
      UserError: they are not.
    """
    for name, expected in (("obs_layout", obs_dim), ("action_scale", action_dim)):
        found = len(getattr(source, name))
        if found != expected:
            raise UserError(f"provenance.{name} has {found} entries, expected {expected}")
    if any(len(column) != 2 for column in source.obs_layout):
        raise UserError("provenance.obs_layout is not a list of [name, unit]")


def check_scene(source: Provenance) -> None:
    """Checks that the peg and the socket of a recording can be built.

    Raises:
      UserError: there is no such shape, there are several, or they are too far from each other.
    """
    try:
        count = len(shapes.read(source.shape))
        if count != 1:
            raise ValueError(f"got {count} shapes, expected one")
        if shapes.inlined(source.shape) != source.shape:
            raise ValueError(f"got {source.shape!r}, a file, expected a digit or a grid itself")
    except ValueError as error:
        raise UserError(f"provenance.shape: {error}") from None
    scene = Scene(clearance=source.clearance_m)
    try:
        limits.check_limits(scene, "--scene.")
        validation.validate_parts(scene, source.shape)
    except UserError as error:
        raise UserError(f"provenance.clearance_m: {error}") from None


def check_shift(source: Provenance, socket_offset: np.ndarray) -> None:
    """Checks that sockets stood [K, 2] m from their nominal place as far as is said.

    Raises:
      UserError: the square that is said is none of a task, or a socket stood outside it.
    """
    shift, furthest = source.shift_m, float(np.abs(socket_offset).max())
    if not 0 <= shift <= LARGEST_SHIFT:
        raise UserError(
            f"provenance.shift_m is {shift:g}, expected 0 to {LARGEST_SHIFT:g}; check its unit"
        )
    if furthest > shift / 2 + 1e-6:
        raise UserError(
            f"socket_offset is up to {furthest:g} m, expected at most half of provenance.shift_m "
            f"({shift:g} m); correct one of them"
        )


def to_json(provenance: Provenance) -> str:
    """The text that `from_json` reads."""
    return json.dumps(dataclasses.asdict(provenance))


def from_json(text: str) -> Provenance:
    """Reads and checks the JSON text of a file.

    Raises:
      UserError: it is not the JSON object described by `Provenance`.
    """
    try:
        values = json.loads(text)
        json.dumps(values, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:
        raise UserError(f"provenance is not JSON: {error}") from error
    if not isinstance(values, dict):
        raise UserError(f"provenance is a JSON {type(values).__name__}, expected an object")
    if values.get("schema") != SCHEMA:
        raise UserError(f"schema is {values.get('schema')!r}, this program reads {SCHEMA}")
    hints = typing.get_type_hints(Provenance)
    if values.keys() != hints.keys():
        raise UserError(
            f"provenance lacks {sorted(hints.keys() - values.keys())} and has unknown "
            f"{sorted(values.keys() - hints.keys())}"
        )
    for name, hint in hints.items():
        if not _matches(values[name], hint):
            raise UserError(f"provenance.{name} is {str(values[name])[:40]!r}, expected {hint}")
    return Provenance(**values)


def _matches(value: Any, hint: Any) -> bool:
    if hint is float:
        return type(value) in (int, float) and abs(value) < 1e300
    if typing.get_origin(hint) is list:
        return type(value) is list and all(_matches(v, typing.get_args(hint)[0]) for v in value)
    if typing.get_origin(hint) is dict:
        return type(value) is dict and all(type(v) is str for v in value.values())
    return type(value) is hint
