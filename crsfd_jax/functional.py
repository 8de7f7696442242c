"""The task as pure functions of one environment, in the shape that MuJoCo Playground made known.

A view of `env.Env`. `jax.vmap` makes many environments of it, with the native engine too. `step`
goes on simulating where an episode has ended: automatic resets are left to wrappers.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import flax.struct
import jax
import jax.numpy as jnp
import mujoco

from crsfd_jax import task
from crsfd_jax.config import Config
from crsfd_jax.env import EnvState
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.options.shapes import read
from crsfd_jax.physics.interface import CONTROL_DT
from crsfd_jax.scene.build import model_of


@flax.struct.dataclass(kw_only=True)
class State:
    """One environment between two control steps."""

    data: EnvState
    """Without its leading axis."""
    obs: jax.Array
    """[O]; where the simulation broke down, the last observation before."""
    reward: jax.Array
    """[] 1 at full insertion, else 0."""
    done: jax.Array
    """[] float32, 1 where the episode ended: inserted, out of time or broken down."""
    metrics: dict[str, jax.Array]
    """[] float32 each: success; nonfinite, 1 where the simulation broke down."""
    info: dict[str, jax.Array]
    """[] float32: truncation, 1 where the episode ended without insertion."""


class Insertion(NamedTuple):
    """The functions of the task and its sizes."""

    reset: Callable[[jax.Array], State]
    """(key) -> the start of an episode."""
    step: Callable[[State, jax.Array], State]
    """(state, action [A]) -> state one control step later."""
    action_size: int
    observation_size: int
    dt: float
    """s, one control step."""
    sim_dt: float
    """s, one physics step."""
    n_substeps: int
    mj_model: mujoco.MjModel
    """For pictures, with the first of the shapes; the socket of an episode may lie elsewhere."""


def make(options: Config) -> Insertion:
    """The task of a configuration; only what defines the task and its engine matters."""
    env = task.make_env(options)
    scene = task.scene_of(options)

    def reset(key: jax.Array) -> State:
        data = _only(env.reset(key, 1))
        zero = jnp.float32(0)
        metrics = {"success": zero, "nonfinite": zero}
        info = {"truncation": zero}
        return State(data=data, obs=data.obs, reward=zero, done=zero, metrics=metrics, info=info)

    def step(state: State, action: jax.Array) -> State:
        before = jax.tree.map(lambda leaf: leaf[None], state.data)
        data, outcome = _only(env.advance(before, action[None]))
        return State(
            data=data,
            obs=jnp.where(outcome.finite, outcome.next_obs, state.obs),
            reward=outcome.reward,
            done=jnp.float32(outcome.over),
            metrics={
                "success": jnp.float32(outcome.terminated),
                "nonfinite": jnp.float32(~outcome.finite),
            },
            info={**state.info, "truncation": jnp.float32(outcome.failed)},
        )

    sim_dt = scene.model.opt.timestep
    return Insertion(
        reset=reset,
        step=step,
        action_size=ACTION_SIZE,
        observation_size=OBS_SIZE,
        dt=CONTROL_DT,
        sim_dt=sim_dt,
        n_substeps=round(CONTROL_DT / sim_dt),
        mj_model=model_of(scene, scene.shapes.index(read(options.shape)[0])),
    )


def _only(batch: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[0], batch)
