"""From options to an environment: scene, engine and the distribution of episodes."""

import functools
from typing import Any

import jax
import numpy as np

from crsfd_jax import config, env
from crsfd_jax.options.shapes import read
from crsfd_jax.physics import select
from crsfd_jax.physics.interface import Engine
from crsfd_jax.scene import randomize
from crsfd_jax.scene.build import Scene, build
from crsfd_jax.scene.kinematics import chain


def engine(
    name: str, parts: config.Scene, shapes: tuple[str, ...] = config.SHAPES
) -> tuple[Engine, Scene]:
    """An engine and its scene, made once for all environments that use them."""
    return _engine(name, parts, shapes)


def scene_of(options: config.Config) -> Scene:
    """The scene of a run with all shapes that it may meet."""
    return build(options.scene, shapes_known(options))


def shapes_known(options: config.Config) -> tuple[str, ...]:
    """Shapes of a run's scene: every digit, and the grids that the run brings."""
    return tuple(dict.fromkeys((*config.SHAPES, *read(options.shape))))


@functools.cache
def _engine(name, parts, shapes):
    scene = build(parts, shapes)
    # What is kept must be no part of the program that happens to be traced.
    with jax.ensure_compile_time_eval():
        return select.make(name, scene), scene


@functools.cache
def _start_pool() -> np.ndarray:
    with jax.ensure_compile_time_eval():
        return randomize.start_pool(chain(build(config.Scene())))


def make_env(
    options: config.Config,
    reward: env.Reward = env.sparse_reward,
    shapes: Any = None,
    shift: Any = None,
) -> env.Env:
    """The environment of a run.

    Args:
      shapes: [n] which of the scene's shapes episodes are drawn from, if not those of the options.
      shift: [] m, likewise; both may be traced.
    """
    known = shapes_known(options)
    physics, scene = engine(select.resolve(options.engine), options.scene, known)
    distribution = randomize.Distribution(
        start_qpos=_start_pool(),
        shapes=tuple(map(known.index, read(options.shape))) if shapes is None else shapes,
        shift=options.shift if shift is None else shift,
        friction=options.scene.friction,
        randomisation=options.randomisation,
    )
    return env.make(physics, scene, options.mdp, distribution, reward)
