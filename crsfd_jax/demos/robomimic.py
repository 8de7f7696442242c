"""Demonstrations as the HDF5 files of robomimic.

    data                 attributes total, env_args (JSON), provenance (JSON, ours)
    data/demo_i          attribute num_samples
      obs/NAME           [T, n] one for each part of the observation, scaled as the policy sees it
      next_obs/NAME      [T, n]
      actions            [T, 6]
      rewards, dones     [T]
      states             [T, 16] joint angles and velocities, offset of the socket; rad, rad/s, m
      terminated, truncated  [T] (ours: a done alone does not tell them apart)
    mask/success         names of the episodes that end inserted

Source: robomimic's documentation, "Dataset Structure", and the keys that its SequenceDataset reads.
"""

import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from crsfd_jax import extras
from crsfd_jax.demos import dataset, hdf5, layout
from crsfd_jax.demos.provenance import to_json
from crsfd_jax.errors import UserError
from crsfd_jax.observation import ACTION_SIZE, OBSERVATION, SCALE
from crsfd_jax.physics.interface import CONTROL_DT
from crsfd_jax.storage.files import output, write_atomically

_GYM = 2
"""robomimic's number for environments that gymnasium makes."""
_STATE_SIZE = 2 * dataset.ARM_JOINTS + 2
_STATE_PARTS = (dataset.ARM_JOINTS, 2 * dataset.ARM_JOINTS)


def write(path: str | Path, demos: dataset.Demonstrations) -> None:
    """Writes demonstrations, all or nothing.

    Raises:
      UserError: h5py is missing or the file cannot be written.
    """
    extras.require("robomimic files", "data", "h5py")
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        data = file.create_group("data")
        data.attrs["total"] = len(demos.obs)
        kwargs = {"shape": demos.provenance.shape}
        args = {"env_name": layout.ENV_NAME, "type": _GYM, "env_kwargs": kwargs}
        data.attrs["env_args"] = json.dumps(args)
        data.attrs["provenance"] = to_json(demos.provenance)
        for number, episode in enumerate(layout.episodes_of(demos)):
            _write_episode(data.create_group(f"demo_{number}"), episode)
        success = np.flatnonzero(dataset.episode_success(demos))
        file["mask/success"] = np.array([f"demo_{number}" for number in success], "S")
    with output(path):
        write_atomically(Path(path), lambda out: out.write(stream.getbuffer()))


def read(path: str | Path) -> dataset.Demonstrations:
    """Reads what `write` wrote, or another tool in the same layout with the same robot.

    Raises:
      UserError: the file is damaged or does not fit; names the file and the reason.
    """
    with hdf5.open_checked(path) as file:
        data = file.get("data")
        if data is None or not hasattr(data, "keys"):
            raise UserError("lacks the group data, expected the layout of robomimic")
        _check_environment(data)
        names = _episode_names(data)
        budget = hdf5.Budget()
        episodes = [_read_episode(data[name], budget) for name in names]
        provenance = layout.read_provenance(hdf5.read_text(data, "provenance"))
        return layout.join(episodes, provenance)


def _write_episode(group: Any, episode: layout.Episode) -> None:
    group.attrs["num_samples"] = len(episode.reward)
    arrays = {
        "actions": episode.action,
        "rewards": episode.reward,
        "dones": (episode.terminated | episode.truncated).astype(np.int64),
        "states": _states(episode),
        "terminated": episode.terminated,
        "truncated": episode.truncated,
    }
    first = 0
    for name, size, _, _ in OBSERVATION:
        arrays[f"obs/{name}"] = episode.obs[:, first : first + size]
        arrays[f"next_obs/{name}"] = episode.next_obs[:, first : first + size]
        first += size
    for name, array in arrays.items():
        group.create_dataset(name, data=array, compression="gzip")


def _states(episode: layout.Episode) -> np.ndarray:
    """[T, 16]; the first row holds the start exactly, the others follow from observations."""
    joints = dataset.ARM_JOINTS
    moved = (episode.obs - episode.obs[0])[:, :joints] * SCALE[:joints]
    velocity = (episode.obs * SCALE)[:, joints : 2 * joints]
    offset = np.broadcast_to(episode.socket_offset, (len(moved), 2))
    return np.concatenate([episode.start_qpos + moved, velocity, offset], axis=1, dtype=np.float32)


def _check_environment(data: Any) -> None:
    args = layout.as_json(hdf5.read_text(data, "env_args"), "data's attribute env_args")
    kwargs = args.get("env_kwargs")
    kwargs = kwargs if isinstance(kwargs, dict) else {}
    layout.check_env_name(args.get("env_name"), kwargs.get("robots"))
    rate = kwargs.get("control_freq", 1 / CONTROL_DT)
    if rate != 1 / CONTROL_DT:
        raise UserError(f"recorded at {rate} Hz, expected {1 / CONTROL_DT:g} Hz")


def _episode_names(data: Any) -> list[str]:
    names = list(data)
    odd = [n for n in names if not (re.fullmatch(r"demo_\d{1,9}", n) and hasattr(data[n], "keys"))]
    if odd or not names:
        raise UserError(
            f"data holds {odd[0] if odd else 'nothing'}, expected the groups demo_0, demo_1, ..."
        )
    return sorted(names, key=lambda name: int(name.removeprefix("demo_")))


def _read_episode(group: Any, budget: hdf5.Budget) -> layout.Episode:
    action = hdf5.read(group, "actions", budget)
    if action.ndim != 2 or action.shape[1] != ACTION_SIZE:
        raise UserError(f"{group.name}/actions is {action.shape}, expected (T, {ACTION_SIZE})")
    reward = hdf5.read(group, "rewards", budget)
    states = hdf5.read(group, "states", budget)
    if states.ndim != 2 or states.shape[1] != _STATE_SIZE or not len(states):
        raise UserError(f"{group.name}/states is {states.shape}, expected (T, {_STATE_SIZE})")
    start_qpos, _, socket_offset = np.split(states[0], _STATE_PARTS)
    terminated, truncated = _ends(group, reward, budget)
    return layout.Episode(
        obs=_read_observation(group, "obs", budget),
        next_obs=_read_observation(group, "next_obs", budget),
        action=action,
        reward=reward,
        terminated=terminated,
        truncated=truncated,
        start_qpos=start_qpos,
        socket_offset=socket_offset,
    )


def _read_observation(group: Any, name: str, budget: hdf5.Budget) -> np.ndarray:
    found = group.get(name)
    parts = list(found) if hasattr(found, "keys") else []
    lacking = [part for part, *_ in OBSERVATION if part not in parts]
    if lacking:
        images = [part for part in parts if getattr(found[part], "ndim", 0) >= 4]
        only = ", images only" if images and len(images) == len(parts) else ""
        raise UserError(
            f"{group.name}/{name} lacks {', '.join(lacking)}; holds "
            f"{', '.join(parts)[:80] or 'nothing'}{only}"
        )
    arrays = [hdf5.read(found, part, budget) for part, *_ in OBSERVATION]
    for array, (part, size, _, _) in zip(arrays, OBSERVATION, strict=True):
        if array.ndim != 2 or array.shape[1] != size or len(array) != len(arrays[0]):
            raise UserError(f"{group.name}/{name}/{part} is {array.shape}, expected (T, {size})")
    return np.concatenate(arrays, axis=1)


def _ends(group: Any, reward: np.ndarray, budget: hdf5.Budget) -> tuple[np.ndarray, np.ndarray]:
    """Terminated and truncated; where only the layout's own fields are, a reward tells them."""
    if "terminated" in group and "truncated" in group:
        return hdf5.read(group, "terminated", budget), hdf5.read(group, "truncated", budget)
    is_last = np.arange(reward.size) == reward.size - 1
    success = reward.ravel() > 0
    return is_last & success, is_last & ~success
