"""The policies of a run acting in the native engine, one control step at a time."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax import config, env, task
from crsfd_jax.env import EnvState, Outcome
from crsfd_jax.errors import UserError
from crsfd_jax.learn import networks
from crsfd_jax.observation import ACTION_SIZE
from crsfd_jax.options.shapes import read
from crsfd_jax.scene.build import Scene
from crsfd_jax.scene.kinematics import chain
from crsfd_jax.storage import trained

_ENGINE = "native"
_ENDLESS = 100_000
"""Steps after which the environment itself would end an episode; viewers end it earlier."""


class Task(NamedTuple):
    """What a viewer may change about the task."""

    shape: str
    shift: float
    """m, side of the square of socket offsets."""
    friction: float | None = None
    """None for what an episode of training would draw."""


class Step(NamedTuple):
    """One control step of one arm."""

    state: EnvState
    """As the step left it, also at the end of an episode."""
    outcome: Outcome
    setpoint: np.ndarray
    """[6] m and rad, what the impedance control pulled the tip towards."""


class Live(NamedTuple):
    """One arm, and the policies that can move it."""

    scene: Scene
    config: config.Config
    actors: Any
    """Actor parameters of all seeds, [S, ...] each."""
    reset: Callable[[Task, jax.Array], EnvState]
    """(task, key) -> a fresh episode."""
    change_friction: Callable[[EnvState, float], EnvState]
    """The episode goes on under another friction."""
    act: Callable[[Any, int, EnvState], jax.Array]
    """(actors, row of the seed, state) -> action [1, 6] of the deterministic policy."""
    advance: Callable[[EnvState, jax.Array], Step]
    """No episode is truncated: how long it may take is the caller's choice."""


def load(run: str) -> Live:
    """The policies of a run folder.

    Raises:
      UserError: the folder holds no run or no policy.
    """
    policies = trained.load(run)
    return make(policies.config, policies.actors)


def task_of(loaded: Live, shape: str | None, shift: float | None) -> Task:
    """The task that a command line asks for; None stands for the run's own value.

    Raises:
      UserError: the run's scene has no such shape.
    """
    options = loaded.config
    shown = shape or read(options.shape)[0]
    if shown not in loaded.scene.shapes:
        known = ", ".join(name.partition("=")[0] for name in loaded.scene.shapes)
        raise UserError(f"--shape: got {shown!r}, allowed for this run: {known}; choose one")
    side = options.shift if shift is None else shift
    return Task(shown, side)


def make(options: config.Config, actors: Any) -> Live:
    """One arm in the scene of the options.

    Args:
      actors: actor parameters of all seeds, [S, ...] each.
    """
    endless = dataclasses.replace(options.mdp, horizon=_ENDLESS)
    world = task.make_env(dataclasses.replace(options, engine=_ENGINE, mdp=endless))
    scene = task.scene_of(options)
    nets = networks.make_networks(options.sac, ACTION_SIZE)
    advance = jax.jit(world.advance)
    links = chain(scene)

    @jax.jit
    def command(state: EnvState, action: jax.Array) -> jax.Array:
        return env.command(links, state, env.setpoint(options.mdp, state.tip, action))

    def change_friction(state: EnvState, friction: float) -> EnvState:
        everywhere = jnp.full(1, friction, jnp.float32)
        return state.replace(around=state.around.replace(friction=everywhere))

    def reset(wanted: Task, key: jax.Array) -> EnvState:
        start_key, offset_key = jax.random.split(key)
        state, half = world.reset(start_key, 1), wanted.shift / 2
        around = state.around.replace(
            shape=jnp.full(1, scene.shapes.index(wanted.shape), jnp.int32),
            socket_offset=jax.random.uniform(offset_key, (1, 2), minval=-half, maxval=half),
        )
        state = state.replace(around=around)
        return state if wanted.friction is None else change_friction(state, wanted.friction)

    @jax.jit
    def act(actors: Any, row: int, state: EnvState) -> jax.Array:
        actor = jax.tree.map(lambda leaf: leaf[row], actors)
        return networks.mode_action(nets.actor, actor, state.obs)

    def step(state: EnvState, action: jax.Array) -> Step:
        after, outcome = advance(state, action)
        return Step(after, outcome, np.asarray(command(state, action))[0])

    return Live(scene, options, actors, reset, change_friction, act, step)
