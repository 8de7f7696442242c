"""Demonstrations by a person's hand: a goal for the tip becomes actions, and episodes a file."""

import dataclasses
from typing import NamedTuple

import numpy as np

from crsfd_jax import config
from crsfd_jax.demos import dataset, layout, recordable
from crsfd_jax.env import EnvState, Outcome

LONGEST = 600
"""Control steps, a minute: an episode by hand that takes longer is truncated."""


class Taken(NamedTuple):
    """One control step under a person's hand."""

    before: EnvState
    action: np.ndarray
    """[6]."""
    outcome: Outcome


def action_towards(mdp: config.Mdp, tip: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """[1, 6] float32 action that brings the tip's setpoint as near to a goal as one step can.

    Args:
      tip: [6] m and rad, in the nominal socket's frame.
      goal: [6] likewise.
    """
    return np.clip((goal - tip) / np.array(mdp.action_scale), -1, 1)[None].astype(np.float32)


def episode(steps: list[Taken]) -> layout.Episode:
    """The steps of one episode, truncated where it stopped unless it had ended itself."""

    def stack(values) -> np.ndarray:
        return np.stack([np.asarray(value)[0] for value in values])

    terminated = stack(step.outcome.terminated for step in steps)
    truncated = np.zeros_like(terminated)
    truncated[-1] = not terminated[-1]
    start = steps[0].before
    return layout.Episode(
        obs=stack(step.before.obs for step in steps),
        next_obs=stack(step.outcome.next_obs for step in steps),
        action=np.stack([step.action for step in steps]),
        reward=stack(step.outcome.reward for step in steps),
        terminated=terminated,
        truncated=truncated,
        start_qpos=np.asarray(start.physics.qpos)[0],
        socket_offset=np.asarray(start.around.socket_offset)[0],
    )


def demonstrations(
    episodes: list[layout.Episode], options: config.Config, shape: str, shift: float, command: str
) -> dataset.Demonstrations:
    """Everything that was recorded, ready to be saved.

    Raises:
      UserError: there is no episode.
    """
    success = [bool(one.terminated[-1]) for one in episodes]
    source = recordable.provenance(
        dataclasses.replace(options, shape=shape, shift=shift),
        expert="recorded by hand",
        expert_success_rate=float(np.mean(success)) if success else 0.0,
        noise=0.0,
        seed=0,
        command=command,
    )
    return layout.join(episodes, source)
