"""From options to an environment: scene, engine and the distribution of episodes."""

import functools

import numpy as np

from crsfd_jax import config, env
from crsfd_jax.physics import select
from crsfd_jax.physics.interface import Engine
from crsfd_jax.scene import randomize
from crsfd_jax.scene.build import Scene, build
from crsfd_jax.scene.kinematics import chain


@functools.cache
def engine(name: str, parts: config.Scene) -> tuple[Engine, Scene]:
    """An engine and its scene, made once for all environments that use them."""
    scene = build(parts)
    return select.make(name, scene), scene


@functools.cache
def _start_pool(parts: config.Scene) -> np.ndarray:
    return randomize.start_pool(chain(build(parts)))


def make_env(options: config.Config, reward: env.Reward = env.sparse_reward) -> env.Env:
    """The environment of a run."""
    physics, scene = engine(select.resolve(options.engine), options.scene)
    friction = options.scene.friction
    distribution = randomize.Distribution(
        start_qpos=_start_pool(options.scene),
        shapes=(scene.shapes.index(options.shape),),
        shift=options.shift,
        friction=(friction, friction),
    )
    return env.make(physics, scene, options.mdp, distribution, reward)
