"""The task for Gymnasium: importing this module registers crsfd/Insertion-v0.

`gymnasium.make` gives one environment, `gymnasium.make_vec` a batch that the engine steps at
once. Keywords are those of `keywords.to_config`; the engine is native unless another is named.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from crsfd_jax import extras, functional, task
from crsfd_jax.config import Config
from crsfd_jax.demos.layout import ENV_NAME
from crsfd_jax.drawing import opengl
from crsfd_jax.drawing.picture import render
from crsfd_jax.env import EnvState
from crsfd_jax.errors import UserError
from crsfd_jax.observation import ACTION_SIZE, CLIP, OBS_SIZE
from crsfd_jax.options import keywords
from crsfd_jax.scene.build import model_of, place_socket

try:
    import gymnasium
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"crsfd_jax.gym: needs {error.name}, which is not installed; "
        f"{extras.install_command('gym')}"
    ) from error

ID = ENV_NAME
_METADATA = {"render_modes": ["rgb_array"], "render_fps": 10}
_WIDTH, _HEIGHT = 640, 480


class Insertion(gymnasium.Env):
    """One environment; `info["is_success"]` says whether the peg is fully inserted."""

    metadata = _METADATA

    def __init__(self, render_mode: str | None = None, **values: Any):
        """See the module.

        Raises:
          UserError: a value or mode cannot be used, or pictures are wanted and OpenGL is missing.
        """
        self._options = _options(values)
        self._task = _compiled(self._options)
        self.render_mode = _checked(render_mode)
        self.observation_space, self.action_space = _spaces()
        self._state: functional.State | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Starts an episode; there are no options."""
        super().reset(seed=seed)
        self._state = self._task.reset(_key(self.np_random))
        return np.array(self._state.obs), {"is_success": False}

    def step(self, action: np.ndarray):
        """Makes one control step of 0.1 s; a simulation that breaks down is truncated."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("step: call reset first")
        actions = jnp.asarray(_as_actions(action, self.action_space))
        self._state = self._task.step(self._state, actions)
        obs, reward, success, truncated = jax.device_get(
            (
                self._state.obs,
                self._state.reward,
                self._state.metrics["success"],
                self._state.info["truncation"],
            )
        )
        ended = bool(success), bool(truncated)
        return np.array(obs), float(reward), *ended, {"is_success": bool(success)}

    def render(self) -> np.ndarray | None:
        """uint8 [480, 640, 3] of the current state if render_mode is rgb_array."""
        if self.render_mode is None or self._state is None:
            return None
        return _draw(self._options, jax.device_get(self._state.data))


class InsertionVector(VectorEnv):
    """A batch of environments; an ended episode is replaced in the step that ends it."""

    metadata = _METADATA | {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(self, num_envs: int = 1, render_mode: str | None = None, **values: Any):
        """See the module.

        Raises:
          UserError: a value or mode cannot be used, or pictures are wanted and OpenGL is missing.
        """
        if num_envs < 1:
            raise UserError(f"num_envs: got {num_envs}, allowed: at least 1; raise it")
        self._options = _options(values)
        self._batch = _compiled_batch(self._options)
        self.num_envs, self.render_mode = num_envs, _checked(render_mode)
        self.single_observation_space, self.single_action_space = _spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._state: EnvState | None = None
        self._steps = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Starts all episodes; there are no options."""
        super().reset(seed=seed)
        start_key, self._key = jax.random.split(_key(self.np_random))
        self._state, self._steps = self._batch.reset(start_key, self.num_envs), 0
        return np.array(self._state.obs), self._infos()

    def step(self, actions: np.ndarray):
        """Makes one control step; final_obs and final_info hold what ended episodes ended with."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("step: call reset first")
        actions = _as_actions(actions, self.action_space)
        self._steps += 1
        self._state, result = self._batch.step(self._state, actions, self._key, self._steps)
        obs, final_obs, reward, terminated, truncated = map(np.array, jax.device_get(result))
        infos = self._infos()
        over = terminated | truncated
        if over.any():
            rows = np.full(self.num_envs, None, object)
            for i in np.flatnonzero(over):
                rows[i] = final_obs[i].copy()
            final = {"is_success": terminated.copy(), "_is_success": over.copy()}
            infos |= {"final_obs": rows, "_final_obs": over}
            infos |= {"final_info": final, "_final_info": over.copy()}
        return obs, reward.astype(np.float64), terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """uint8 [480, 640, 3] of each environment if render_mode is rgb_array."""
        if self.render_mode is None or self._state is None:
            return None
        states = jax.device_get(self._state)
        return tuple(_draw(self._options, _row(states, i)) for i in range(self.num_envs))

    def _infos(self) -> dict[str, Any]:
        nothing = np.zeros(self.num_envs, bool)
        return {"is_success": nothing, "_is_success": ~nothing}


class _Batch(NamedTuple):
    reset: Callable[..., EnvState]
    step: Callable[..., tuple[EnvState, tuple[jax.Array, ...]]]


@functools.cache
def _compiled(options: Config) -> functional.Insertion:
    made = functional.make(options)
    return made._replace(reset=jax.jit(made.reset), step=jax.jit(made.step))


@functools.cache
def _compiled_batch(options: Config) -> _Batch:
    env = task.make_env(options)

    def step(state, action, key, count):
        after, outcome = env.step(state, action, jax.random.fold_in(key, count))
        # What broke down has no observation: the one before it stands in.
        final_obs = jnp.where(outcome.finite[:, None], outcome.next_obs, state.obs)
        return after, (after.obs, final_obs, outcome.reward, outcome.terminated, outcome.failed)

    return _Batch(jax.jit(env.reset, static_argnums=1), jax.jit(step))


def _options(values: dict[str, Any]) -> Config:
    return keywords.to_config(**{"engine": "native", **values})


def _spaces() -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    return (
        gymnasium.spaces.Box(-CLIP, CLIP, (OBS_SIZE,), np.float32),
        gymnasium.spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32),
    )


def _checked(render_mode: str | None) -> str | None:
    allowed = _METADATA["render_modes"]
    if render_mode not in (None, *allowed):
        raise UserError(
            f"render_mode: got {render_mode!r}, allowed: None, {', '.join(allowed)}; choose one"
        )
    if render_mode is not None:
        opengl.platform()
    return render_mode


def _key(random: np.random.Generator) -> jax.Array:
    return jax.random.key(int(random.integers(2**31)))


def _as_actions(actions: Any, space: gymnasium.Space) -> np.ndarray:
    array = np.asarray(actions, np.float32)
    if array.shape != space.shape:
        raise ValueError(f"action: got shape {array.shape}, allowed: {space.shape}; reshape it")
    return array


def _row(states: EnvState, i: int) -> EnvState:
    return jax.tree.map(lambda leaf: leaf[i], states)


def _draw(options: Config, state: EnvState) -> np.ndarray:
    scene = task.scene_of(options)
    model = model_of(scene, int(state.around.shape))
    data = mujoco.MjData(model)
    data.qpos[:] = state.physics.qpos
    place_socket(data, scene, state.around.socket_offset, state.around.socket_yaw)
    mujoco.mj_forward(model, data)
    return render(model, data, "close", _WIDTH, _HEIGHT)


gymnasium.register(
    ID, entry_point=f"{__name__}:Insertion", vector_entry_point=f"{__name__}:InsertionVector"
)
