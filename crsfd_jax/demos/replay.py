"""Replays demonstrations in the simulator: does each do again what its file says?"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax import config, task
from crsfd_jax.demos.dataset import Demonstrations, episode_success
from crsfd_jax.demos.layout import check_task
from crsfd_jax.env import Env, EnvState
from crsfd_jax.observation import POSE_SCALE, TIP_POSE


class Replayed(NamedTuple):
    """Outcome of replaying K episodes with their recorded actions."""

    success: np.ndarray
    """[K] bool, inserted in the replay."""
    recorded_success: np.ndarray
    """[K] bool, inserted according to the file."""
    deviation: np.ndarray
    """[K] m, largest distance between replayed and recorded tip position; infinite where the
    simulation broke down."""


def replay(demos: Demonstrations, engine: str = "auto") -> Replayed:
    """Plays every episode from its recorded start with its recorded actions.

    Raises:
      UserError: the file was recorded for another control step or action scale, or with a peg
        that there cannot be.
    """
    options = _options(demos, engine)
    env = task.make_env(options)
    actions, recorded, is_played = _by_time(demos, env.horizon)
    start = _start(env, demos)
    tips, terminated = jax.jit(_roll, static_argnums=0)(env, start, actions)
    distance = np.linalg.norm(np.asarray(tips)[..., :3] - recorded, axis=-1)
    distance = np.nan_to_num(distance, nan=np.inf)
    return Replayed(
        success=np.any(np.asarray(terminated) & is_played, axis=0),
        recorded_success=episode_success(demos),
        deviation=np.where(is_played, distance, 0.0).max(axis=0),
    )


def _options(demos: Demonstrations, engine: str) -> config.Config:
    source, mdp = demos.provenance, config.Mdp()
    check_task(demos)
    parts = dataclasses.replace(config.Scene(), clearance=source.clearance_m)
    horizon = max(mdp.horizon, int(demos.episode_length.max()))
    return config.Config(
        shape=source.shape,
        engine=engine,  # pyright: ignore[reportArgumentType]
        scene=parts,
        mdp=dataclasses.replace(mdp, horizon=horizon),
    )


def _start(env: Env, demos: Demonstrations) -> EnvState:
    count = len(demos.episode_length)
    start = env.reset(jax.random.key(0), count)
    first = np.concatenate([[0], np.cumsum(demos.episode_length)[:-1]])
    return start.replace(
        physics=start.physics.replace(qpos=jnp.asarray(demos.start_qpos)),
        around=start.around.replace(socket_offset=jnp.asarray(demos.socket_offset)),
        tip=jnp.asarray(demos.obs[first, TIP_POSE] * POSE_SCALE),
        obs=jnp.asarray(demos.obs[first]),
    )


def _roll(env: Env, start: EnvState, actions: jax.Array):
    def body(state, action):
        # Not `step`: an episode that ends a step early must not go on as another one.
        state, outcome = env.advance(state, action)
        return state, (outcome.tip, outcome.terminated)

    return jax.lax.scan(body, start, actions)[1]


def _by_time(demos: Demonstrations, horizon: int):
    """Actions [T, K, A], recorded tip positions [T, K, 3] after each step, played [T, K]."""
    length = demos.episode_length
    is_played = np.arange(horizon)[None] < length[:, None]
    actions = np.zeros((len(length), horizon, demos.action.shape[1]), np.float32)
    positions = np.zeros((len(length), horizon, 3), np.float32)
    actions[is_played] = demos.action
    positions[is_played] = (demos.next_obs[:, TIP_POSE] * POSE_SCALE)[:, :3]
    return actions.swapaxes(0, 1), positions.swapaxes(0, 1), is_played.T
