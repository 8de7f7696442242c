"""Demonstrations as data sets of Minari, written and read by its own library.

An episode's options hold start_qpos and socket_offset, the data set's metadata our provenance.
Data sets lie under MINARI_DATASETS_PATH, or ~/.minari/datasets.
"""

import contextlib
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from crsfd_jax import extras
from crsfd_jax.demos import dataset, hdf5, layout
from crsfd_jax.demos.provenance import to_json
from crsfd_jax.errors import UserError
from crsfd_jax.observation import ACTION_SIZE, CLIP, OBS_SIZE

_FILE = "main_data.hdf5"


def write(name: str, demos: dataset.Demonstrations) -> None:
    """Adds a data set to the local store, all or nothing.

    Raises:
      UserError: minari is missing, the name cannot be used, or the store cannot be written.
    """
    minari, folder = _library(), _folder(name)
    if folder.exists():
        raise UserError(f"--out: got {name!r}, which exists, allowed: a new name; choose another")
    try:
        with _quiet():
            made = minari.create_dataset_from_buffers(
                dataset_id=name,
                buffer=_buffers(demos),
                observation_space=_box(-CLIP, CLIP, OBS_SIZE),
                action_space=_box(-1, 1, ACTION_SIZE),
                algorithm_name=demos.provenance.expert,
                description=dataset.describe(demos),
                requirements=["crsfd-jax"],
            )
            made.storage.update_metadata({"provenance": to_json(demos.provenance)})
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, OSError):
            raise UserError(f"{folder}: cannot be written: {error.strerror}") from error
        raise


def read(name: str) -> dataset.Demonstrations:
    """Reads a data set of the local store.

    Raises:
      UserError: it is missing, damaged, or does not fit; names it and the reason.
    """
    minari, data = _library(), _folder(name) / "data"
    if not data.is_dir():
        raise UserError(f"minari:{name}: not in {data.parent.parent}; see minari list local")
    try:
        provenance = layout.read_provenance(_checked_metadata(data).get("provenance", ""))
        with hdf5.open_checked(data / _FILE) as file:
            hdf5.check_total(file)
        with _quiet():
            stored = minari.load_dataset(name)
            episodes = list(stored.iterate_episodes())
            metadata = list(stored.storage.get_episode_metadata(range(len(episodes))))
        return layout.join([*map(_episode, episodes, metadata)], provenance)
    except UserError as error:
        raise UserError(f"minari:{name}: {error}") from None
    except (OSError, ValueError, KeyError, TypeError, AssertionError, RuntimeError) as error:
        raise UserError(f"minari:{name}: damaged ({type(error).__name__}: {error})") from error


def _library() -> Any:
    extras.require("Minari data sets", "data", "minari", "h5py")
    import minari

    return minari


def _folder(name: str) -> Path:
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.storage.datasets_root_dir import get_dataset_path

    try:
        parse_dataset_id(name)
    except (ValueError, TypeError):
        raise UserError(
            f"minari: got {name!r}, allowed: names such as crsfd/shape0-v0; correct it"
        ) from None
    return Path(get_dataset_path(name))


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Minari warns of every optional description that is left out."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _box(low: float, high: float, size: int) -> Any:
    from gymnasium import spaces

    return spaces.Box(low, high, (size,), np.float32)


def _buffers(demos: dataset.Demonstrations) -> list[Any]:
    from minari.data_collector import EpisodeBuffer

    buffers = []
    for number, episode in enumerate(layout.episodes_of(demos)):
        if not np.array_equal(episode.obs[1:], episode.next_obs[:-1]):
            raise UserError(f"episode {number}: next_obs is not the obs of the next step")
        options = {"start_qpos": episode.start_qpos, "socket_offset": episode.socket_offset}
        arrays: dict[str, Any] = {
            "observations": np.concatenate([episode.obs, episode.next_obs[-1:]]),
            "actions": episode.action,
            "rewards": episode.reward,
            "terminations": episode.terminated,
            "truncations": episode.truncated,
        }
        buffers.append(EpisodeBuffer(id=number, options=options, **arrays))
    return buffers


def _checked_metadata(data: Path) -> dict[str, Any]:
    """The data set's metadata, refused before Minari would build an environment from it."""
    metadata = layout.as_json((data / "metadata.json").read_text(), "metadata.json")
    if metadata.get("data_format") != "hdf5":
        raise UserError(f"data format {metadata.get('data_format')!r}, expected 'hdf5'")
    if metadata.get("env_spec"):
        spec = layout.as_json(str(metadata["env_spec"]), "env_spec")
        layout.check_env_name(spec.get("id"))
    expected = {"observation_space": OBS_SIZE, "action_space": ACTION_SIZE}
    for name, size in expected.items():
        space = layout.as_json(str(metadata.get(name)), name)
        if space.get("type") != "Box" or space.get("shape") != [size]:
            raise UserError(
                f"{name} is {space.get('type')} {space.get('shape', '')}, expected Box [{size}]: "
                "another robot or task"
            )
    return metadata


def _episode(episode: Any, metadata: dict[str, Any]) -> layout.Episode:
    options = metadata.get("options", {})
    lacking = [name for name in ("start_qpos", "socket_offset") if name not in options]
    if lacking:
        raise UserError(f"episode {episode.id} lacks the options {', '.join(lacking)}")
    return layout.Episode(
        obs=episode.observations[:-1],
        next_obs=episode.observations[1:],
        action=episode.actions,
        reward=episode.rewards,
        terminated=episode.terminations,
        truncated=episode.truncations,
        start_qpos=np.asarray(options["start_qpos"]),
        socket_offset=np.asarray(options["socket_offset"]),
    )
