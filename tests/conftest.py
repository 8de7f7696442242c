"""The scene, the engines and the arm that tests share; MJX compiles once for all of them."""

import os
from collections.abc import Callable
from pathlib import Path

# Tests compile far more than they compute: this takes a third of the time of the full level.
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=1"

import crsfd_jax  # noqa: F401, I001
import fault_runs
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import settings

from crsfd_jax import compile_cache, config
from crsfd_jax.physics import mjx, native
from crsfd_jax.physics.interface import Engine, PhysicsState, Surroundings
from crsfd_jax.scene import build, kinematics

# The second time they find what the first compiled: most of their time.
compile_cache.enable()
settings.register_profile("slow machine", deadline=None)
settings.load_profile("slow machine")

PLACES = 256
"""Poses solved at once, so that the inverse kinematics compiles once."""


@pytest.fixture(scope="session")
def scene() -> build.Scene:
    return build.build(config.Scene())


@pytest.fixture(scope="session")
def links(scene) -> kinematics.Chain:
    return kinematics.chain(scene)


@pytest.fixture(scope="session")
def native_engine(scene) -> Engine:
    engine = native.make(scene)
    return engine._replace(advance=jax.jit(engine.advance))


@pytest.fixture(scope="session")
def mjx_engine(scene) -> Engine:
    """Every new batch size compiles for most of a minute: tests use 60."""
    engine = mjx.make(scene)
    return engine._replace(advance=jax.jit(engine.advance))


@pytest.fixture(scope="session")
def at_rest(links) -> Callable[..., PhysicsState]:
    """(position [N, 3] m, rotation vector [N, 3] or [3] rad) -> the arm at rest there."""
    solve = jax.jit(lambda pose: kinematics.inverse_kinematics(links, pose[:, :3], pose[:, 3:]))

    def joints(pose):
        padded = np.zeros((PLACES, 6), np.float32)
        padded[: len(pose)] = pose
        qpos, error = (np.asarray(x)[: len(pose)] for x in solve(padded))
        assert error.max() < 1e-4, "the arm cannot reach a pose of this test"
        return qpos

    def place(position, vector=(0.0, 0.0, 0.0)) -> PhysicsState:
        position = np.asarray(position, np.float32)
        poses = np.concatenate([position, np.broadcast_to(vector, position.shape)], axis=1)
        rows = range(0, len(poses), PLACES)
        qpos = jnp.concatenate([joints(poses[i : i + PLACES]) for i in rows])
        return PhysicsState(qpos=qpos, qvel=jnp.zeros_like(qpos), warmstart=jnp.zeros_like(qpos))

    return place


@pytest.fixture(scope="session")
def around() -> Callable[..., Surroundings]:
    """(shape [N], offset [N, 2] m, friction [N], gains [N, 2], yaw [N] rad) -> surroundings.

    MJX would compile anew for those without gains or yaw.
    """

    def make(shape, offset=(0.0, 0.0), friction=1.0, gains=(1.0, 1.0), yaw=0.0) -> Surroundings:
        shape = jnp.asarray(shape, jnp.int32)
        return Surroundings(
            shape=shape,
            socket_offset=jnp.broadcast_to(jnp.asarray(offset, jnp.float32), (len(shape), 2)),
            friction=jnp.broadcast_to(jnp.asarray(friction, jnp.float32), shape.shape),
            gains=jnp.broadcast_to(jnp.asarray(gains, jnp.float32), (len(shape), 2)),
            socket_yaw=jnp.broadcast_to(jnp.asarray(yaw, jnp.float32), shape.shape),
        )

    return make


@pytest.fixture(scope="session")
def whole(tmp_path_factory) -> Path:
    """A run that no fault befell; it also fills the compilation cache for those that one does."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    code, out = fault_runs.run(folder)
    assert code == 0, out
    return folder
