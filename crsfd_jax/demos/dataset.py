"""Demonstrations in one .npz file: what is in it, reading, checking and writing.

A file holds these arrays and no others; N transitions, K episodes, O and A the sizes of
observation and action. Nothing is ever unpickled.

    obs             [N, O] float32   before the action, scaled and clipped
    action          [N, A] float32   in [-1, 1]
    reward          [N] float32      sparse: 1 where terminated, else 0
    next_obs        [N, O] float32   after the action
    terminated      [N] bool         fully inserted, only at the last step of an episode
    truncated       [N] bool         ended without, only at the last step of an episode
    episode_length  [K] int32        adds up to N; episodes follow each other
    start_qpos      [K, 7] float32   joint angles at the start, rad
    socket_offset   [K, 2] float32   of the socket from its nominal place, m
    provenance      [] str           JSON object with the fields of `Provenance`
"""

import dataclasses
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crsfd_jax.demos.provenance import (
    Provenance,
    check_columns,
    check_shift,
    from_json,
    obs_layout,
    to_json,
)
from crsfd_jax.errors import UserError
from crsfd_jax.observation import CLIP
from crsfd_jax.storage import npz
from crsfd_jax.storage.files import output, write_atomically

ARM_JOINTS = 7
MAX_BYTES = 64 * 2**20
RANGES = {
    "obs": (-CLIP, CLIP),
    "next_obs": (-CLIP, CLIP),
    "action": (-1.0, 1.0),
    "reward": (0.0, 1.0),
    "start_qpos": (-2 * np.pi, 2 * np.pi),
    "socket_offset": (-0.1, 0.1),
}
"""Field -> smallest and largest value; degrees and millimetres fall outside."""


@dataclass(frozen=True, kw_only=True)
class Demonstrations:
    """Recorded episodes, one after the other; see the module for shapes and units."""

    obs: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    next_obs: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    episode_length: np.ndarray
    start_qpos: np.ndarray
    socket_offset: np.ndarray
    provenance: Provenance


def load(path: str | Path, obs_dim: int, action_dim: int) -> Demonstrations:
    """Reads a file and checks all of it.

    Raises:
      UserError: it is missing, damaged or not what the task needs; names file and field.
    """
    arrays = npz.read(Path(path), _dtypes(), MAX_BYTES)
    text = arrays.pop("provenance")
    try:
        provenance = from_json(str(text.item()) if text.shape == () else "")
    except ValueError as error:
        raise UserError(f"demo {path}: {error}") from error
    demos = Demonstrations(**arrays, provenance=provenance)
    check(demos, obs_dim, action_dim, path)
    return demos


def save(path: str | Path, demos: Demonstrations) -> None:
    """Checks demonstrations and writes them, all or nothing.

    Raises:
      UserError: they break the schema, or the file cannot be written.
    """
    check(demos, demos.obs.shape[-1], demos.action.shape[-1], path)
    fields = {name: getattr(demos, name) for name in _dtypes()}
    fields["provenance"] = np.array(to_json(demos.provenance))
    with output(path):
        write_atomically(Path(path), lambda stream: np.savez_compressed(stream, **fields))


def check(demos: Demonstrations, obs_dim: int, action_dim: int, path: str | Path) -> None:
    """Checks demonstrations against the schema and against the sizes of a task.

    Raises:
      UserError: names the file, the first field that is wrong, and what was expected.
    """
    try:
        _check_shapes(demos, obs_dim, action_dim)
        _check_values(demos)
        _check_episodes(demos)
        check_columns(demos.provenance, obs_dim, action_dim)
        check_shift(demos.provenance, demos.socket_offset)
    except UserError as error:
        raise UserError(f"demo {path}: {error}") from None


def episode_success(demos: Demonstrations) -> np.ndarray:
    """[K] bool, whether an episode ended with full insertion."""
    return demos.terminated[np.cumsum(demos.episode_length) - 1]


def describe(demos: Demonstrations) -> str:
    """Several lines for a reader: task, expert, sizes, success, versions."""
    source = demos.provenance
    success = episode_success(demos)
    versions = ", ".join(f"{name} {version}" for name, version in source.versions.items())
    length = demos.episode_length
    return "\n".join(
        (
            f"task      shape {source.shape}, clearance {source.clearance_m * 1e3:g} mm, "
            f"shift {source.shift_m * 1e3:g} mm, control step {source.control_dt_s:g} s",
            f"episodes  {len(length)}, {success.sum()} successful, {length.min()} to "
            f"{length.max()} steps, {length.sum()} transitions",
            f"obs       {len(source.obs_layout)} columns: {_columns(source.obs_layout)}",
            f"action    {len(source.action_scale)} columns, scale "
            f"{', '.join(f'{scale:g}' for scale in source.action_scale)}",
            f"expert    {source.expert}, success rate {source.expert_success_rate:g}, "
            f"noise {source.noise:g}, seed {source.seed}",
            f"recorded  {source.date} by {source.command}",
            f"versions  {versions}",
        )
    )


def _columns(layout: list[list[str]]) -> str:
    """Each part of an observation once, not once for each of its columns."""
    parts = Counter((re.sub(r"_\d+$", "", name), unit) for name, unit in layout)
    lines = (f"{name} {count} [{unit}]" for (name, unit), count in parts.items())
    return ",\n          ".join(lines)


def _dtypes() -> dict[str, type]:
    special = {"terminated": np.bool_, "truncated": np.bool_, "episode_length": np.int32}
    names = (field.name for field in dataclasses.fields(Demonstrations))
    return {name: special.get(name, np.float32) for name in names if name != "provenance"} | {
        "provenance": np.str_
    }


def _check_shapes(demos: Demonstrations, obs_dim: int, action_dim: int) -> None:
    steps, episodes = demos.obs.shape[:1], demos.episode_length.shape[:1]
    expected = {
        "obs": (*steps, obs_dim),
        "action": (*steps, action_dim),
        "reward": steps,
        "next_obs": (*steps, obs_dim),
        "terminated": steps,
        "truncated": steps,
        "episode_length": episodes,
        "start_qpos": (*episodes, ARM_JOINTS),
        "socket_offset": (*episodes, 2),
    }
    for name, shape in expected.items():
        array = getattr(demos, name)
        if array.dtype != _dtypes()[name]:
            raise UserError(f"{name} is {array.dtype}, expected {np.dtype(_dtypes()[name])}")
        if array.shape != shape or not array.size:
            raise UserError(
                f"{name} has shape {array.shape}, expected {shape or '(N,)'}, not empty"
            )


def _check_values(demos: Demonstrations) -> None:
    for name in (name for name, dtype in _dtypes().items() if dtype is np.float32):
        bad = np.argwhere(~np.isfinite(getattr(demos, name)))
        if len(bad):
            raise UserError(f"{len(bad)} non-finite values, first at {name}{bad[0].tolist()}")
    for name, (low, high) in RANGES.items():
        array = getattr(demos, name)
        bad = np.argwhere((array < low) | (array > high))
        if len(bad):
            raise UserError(
                f"{len(bad)} values of {name} outside [{low:g}, {high:g}], first "
                f"{array[tuple(bad[0])]:g} at {name}{bad[0].tolist()}; check its unit"
            )


def check_units(demos: Demonstrations, action_scale: list[float], control_dt_s: float) -> None:
    """Checks that observations and actions mean in a task what they meant in the recording.

    Raises:
      UserError: they are other quantities, last or move otherwise.
    """
    source = demos.provenance
    if abs(source.control_dt_s - control_dt_s) > 1e-6:
        raise UserError(
            f"demonstrations were recorded with control steps of {source.control_dt_s:g} s, "
            f"expected {control_dt_s:g} s; record at that rate"
        )
    if source.obs_layout != obs_layout():
        pairs = zip(source.obs_layout, obs_layout(), strict=False)
        found, expected = next((one, other) for one, other in pairs if one != other)
        raise UserError(
            f"demonstrations hold {' '.join(found)} where {' '.join(expected)} is expected; "
            "record with this package's observation"
        )
    if not np.allclose(source.action_scale, action_scale):
        raise UserError(
            f"demonstrations have the action scale {source.action_scale}, expected {action_scale}; "
            "record with the scales of the task (--mdp.translation-scale, --mdp.rotation-scale)"
        )


def _check_episodes(demos: Demonstrations) -> None:
    length, steps = demos.episode_length, len(demos.obs)
    total = int(length.sum(dtype=np.int64))
    if length.min() < 1 or total != steps:
        raise UserError(
            f"episode_length adds up to {total} with a shortest of {length.min()}, "
            f"expected {steps} and at least 1"
        )
    is_last = np.zeros(steps, bool)
    is_last[np.cumsum(length) - 1] = True
    wrong = np.flatnonzero((demos.terminated | demos.truncated) != is_last)
    if len(wrong):
        raise UserError(
            f"terminated or truncated is wrong at step {wrong[0]}, expected one of them at "
            "the last step of each episode and neither before"
        )
    if not demos.terminated.any():
        raise UserError(f"no successful episode among {len(length)}; record with a better expert")
    dense = np.flatnonzero(demos.reward != demos.terminated)
    if len(dense):
        raise UserError(
            f"reward is {demos.reward[dense[0]]:g} at step {dense[0]}, expected 1 where terminated "
            "and 0 elsewhere; write the sparse reward of the task"
        )
