"""MuJoCo's C engine, many simulations on all cores, called from inside a jitted program."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import mujoco.batch
import numpy as np

from crsfd_jax.physics.interface import CONTROL_DT, Engine, PhysicsState, Surroundings
from crsfd_jax.scene.build import Scene


def make(scene: Scene) -> Engine:
    """The C engine behind a callback; leading axes of a vmap become more simulations."""
    simulate = functools.partial(_simulate, scene, {})

    def step(state: PhysicsState, around: Surroundings, setpoint: jax.Array) -> PhysicsState:
        result = jax.ShapeDtypeStruct((*state.qpos.shape[:-1], 3, 7), jnp.float32)
        packed = jnp.stack([state.qpos, state.qvel, state.warmstart], axis=-2)
        out = jax.pure_callback(
            simulate,
            result,
            packed,
            around.shape,
            around.socket_offset,
            around.friction,
            setpoint,
            vmap_method="broadcast_all",
        )
        return PhysicsState(qpos=out[..., 0, :], qvel=out[..., 1, :], warmstart=out[..., 2, :])

    return Engine(name="native", step=step)


class _Pool:
    """One batch of simulations with the buffers that are written before each call."""

    def __init__(self, scene: Scene, size: int):
        self.scene = scene
        self.batch = mujoco.batch.Batch(scene.model, size, nthread=0, persistent=True)
        self.qpos, self.qvel, self.warmstart, self.ctrl, self.mocap = (
            self.batch.bind(n) for n in ("qpos", "qvel", "qacc_warmstart", "ctrl", "mocap_pos")
        )
        self.geometry = {name: self.batch.expand(name) for name in scene.geometry}
        self.friction = self.batch.expand("geom_friction")
        self.shape_now = np.zeros(size, np.int32)
        self.friction_now = np.full(size, np.nan, np.float32)
        self.substeps = round(CONTROL_DT / scene.model.opt.timestep)

    def set_surroundings(self, shape, offset, friction):
        """Writes only the model fields that changed: shapes rarely do, friction at most at resets."""
        changed = np.flatnonzero(shape != self.shape_now)
        if changed.size:
            for name, table in self.scene.geometry.items():
                self.geometry[name][changed] = table[shape[changed]]
            self.shape_now[changed] = shape[changed]
        changed = np.flatnonzero(friction != self.friction_now)
        if changed.size:
            rows = np.ix_(changed, self.scene.part_geoms)
            self.friction[(*rows, 0)] = friction[changed, None]
            self.friction_now[changed] = friction[changed]
        self.mocap[:, 0] = self.scene.nominal
        self.mocap[:, 0, :2] += offset

    def step(self, packed, setpoint):
        finite = np.isfinite(packed).all(axis=(1, 2)) & np.isfinite(setpoint).all(axis=1)
        packed = np.where(finite[:, None, None], packed, 0.0)
        self.qpos[:], self.qvel[:], self.warmstart[:] = packed[:, 0], packed[:, 1], packed[:, 2]
        self.ctrl[:] = np.where(finite[:, None], setpoint, 0.0)
        self.batch.step(nstep=self.substeps)
        out = np.stack([self.qpos, self.qvel, self.warmstart], axis=1).astype(np.float32)
        out[~finite] = np.nan
        return out


def _simulate(scene, pools, packed, shape, offset, friction, setpoint):
    packed, shape, offset, friction, setpoint = map(
        np.asarray, (packed, shape, offset, friction, setpoint)
    )
    lead = packed.shape[:-2]
    size = int(np.prod(lead))
    if size not in pools:
        pools[size] = _Pool(scene, size)
    pool = pools[size]
    pool.set_surroundings(shape.reshape(size), offset.reshape(size, 2), friction.reshape(size))
    return pool.step(packed.reshape(size, 3, 7), setpoint.reshape(size, 6)).reshape(*lead, 3, 7)
