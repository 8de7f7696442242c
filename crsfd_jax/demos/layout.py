"""What demonstration files of other tools share: episodes as they are, and what must fit."""

import json
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from crsfd_jax import config
from crsfd_jax.demos import dataset
from crsfd_jax.demos.provenance import Provenance, check_scene, from_json
from crsfd_jax.errors import UserError
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.physics.interface import CONTROL_DT

ENV_NAME = "crsfd/Insertion-v0"


class Episode(NamedTuple):
    """One recorded episode of T steps."""

    obs: np.ndarray
    """[T, O]."""
    next_obs: np.ndarray
    """[T, O]."""
    action: np.ndarray
    """[T, A]."""
    reward: np.ndarray
    """[T]."""
    terminated: np.ndarray
    """[T] bool."""
    truncated: np.ndarray
    """[T] bool."""
    start_qpos: np.ndarray
    """[7] rad."""
    socket_offset: np.ndarray
    """[2] m."""


def episodes_of(demos: dataset.Demonstrations) -> Iterator[Episode]:
    """The episodes one by one."""
    ends = np.cumsum(demos.episode_length)
    for i, (first, end) in enumerate(zip(ends - demos.episode_length, ends, strict=True)):
        rows = slice(first, end)
        yield Episode(
            obs=demos.obs[rows],
            next_obs=demos.next_obs[rows],
            action=demos.action[rows],
            reward=demos.reward[rows],
            terminated=demos.terminated[rows],
            truncated=demos.truncated[rows],
            start_qpos=demos.start_qpos[i],
            socket_offset=demos.socket_offset[i],
        )


def join(episodes: list[Episode], provenance: Provenance) -> dataset.Demonstrations:
    """The inverse of `episodes_of`.

    Raises:
      UserError: there is no episode, or an array cannot be what it should be.
    """
    if not episodes:
        raise UserError("holds no episode")
    for number, episode in enumerate(episodes):
        _check_sizes(number, episode)

    def stack(name, dtype):
        return np.concatenate([getattr(episode, name) for episode in episodes]).astype(dtype)

    floats = ("obs", "next_obs", "action", "reward")
    flags = ("terminated", "truncated")
    return dataset.Demonstrations(
        **{name: stack(name, np.float32) for name in floats},
        **{name: stack(name, np.bool_) for name in flags},
        episode_length=np.array([len(episode.reward) for episode in episodes], np.int32),
        start_qpos=np.stack([episode.start_qpos for episode in episodes]).astype(np.float32),
        socket_offset=np.stack([episode.socket_offset for episode in episodes]).astype(np.float32),
        provenance=provenance,
    )


def read_provenance(text: str) -> Provenance:
    """The provenance that an export wrote beside its episodes.

    Raises:
      UserError: it is missing or damaged.
    """
    if not text:
        raise UserError(
            "lacks the attribute provenance: shape, clearance, rate and scales of the recording "
            "are unknown; export it with this package's robot and scene"
        )
    return from_json(text)


def check_env_name(name: object, robots: object = None) -> None:
    """Raises UserError when the episodes are of another environment or robot."""
    if name != ENV_NAME:
        arm = f" with {str(robots)[:60]}" if robots else ""
        raise UserError(
            f"recorded in {str(name)[:60]}{arm}, expected {ENV_NAME}: another robot or task"
        )


def check_task(demos: dataset.Demonstrations) -> None:
    """Checks what an array's shape does not show: rate, scales and shape of the recording.

    Raises:
      UserError: the demonstrations were recorded under other conditions than this task's.
    """
    dataset.check_units(demos, config.Mdp().action_scale, CONTROL_DT)
    check_scene(demos.provenance)


def as_json(text: str, what: str) -> dict:
    """A JSON object.

    Raises:
      UserError: the text is something else.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise UserError(f"{what} is no JSON object")
    return value


def _check_sizes(number: int, episode: Episode) -> None:
    steps = len(episode.reward) if episode.reward.ndim == 1 else -1
    expected = {
        "obs": (steps, OBS_SIZE),
        "next_obs": (steps, OBS_SIZE),
        "action": (steps, ACTION_SIZE),
        "reward": (steps,),
        "terminated": (steps,),
        "truncated": (steps,),
        "start_qpos": (dataset.ARM_JOINTS,),
        "socket_offset": (2,),
    }
    for name, shape in expected.items():
        found = getattr(episode, name)
        if found.dtype.kind not in "fiub" or found.shape != shape or not steps:
            raise UserError(
                f"episode {number}: {name} is {found.dtype} of shape {found.shape}, "
                f"expected numbers of shape {shape}"
            )
