"""MuJoCo's C engine, many simulations on all cores, called from inside a jitted program."""

import functools
import hashlib

import jax
import jax.numpy as jnp
import mujoco
import mujoco.batch
import numpy as np

from crsfd_jax.physics import host_call
from crsfd_jax.physics.interface import CONTROL_DT, Engine, Limits, PhysicsState, Surroundings
from crsfd_jax.scene.build import Scene

_OVERFLOWS = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]
_NUMBER = 1
"""Column of mujoco.batch's warnings that counts them; the other holds what the last one says."""


def make(scene: Scene) -> Engine:
    """The C engine on the host; leading axes of a vmap become more simulations.

    MuJoCo's warnings are silenced where nobody hears them: it would write them to a file in the
    working folder.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda _: None)
    simulate = functools.partial(_simulate, scene, {})
    name = f"mujoco_{_digest(scene)}"

    def advance(
        state: PhysicsState, around: Surroundings, setpoint: jax.Array
    ) -> tuple[PhysicsState, Limits]:
        joints = jax.ShapeDtypeStruct(state.qpos.shape, jnp.float32)
        met = jax.ShapeDtypeStruct(around.shape.shape, jnp.bool_)
        straight = jnp.zeros(around.shape.shape, jnp.float32)
        modelled = jnp.ones((*around.shape.shape, 2), jnp.float32)
        qpos, qvel, warmstart, contacts, solver = host_call.call(
            name,
            simulate,
            (joints, joints, joints, met, met),
            around.shape,
            around.socket_offset,
            straight if around.socket_yaw is None else around.socket_yaw,
            around.friction,
            modelled if around.gains is None else around.gains,
            state.qpos,
            state.qvel,
            state.warmstart,
            setpoint,
        )
        after = PhysicsState(qpos=qpos, qvel=qvel, warmstart=warmstart)
        return after, Limits(contacts=contacts, solver=solver)

    return Engine(name="native", advance=advance)


class _Pool:
    """One batch of simulations with the buffers that are written before each call."""

    def __init__(self, scene: Scene, size: int):
        self.scene = scene
        self.batch = mujoco.batch.Batch(scene.model, size, nthread=0, persistent=True)
        self.motion = [self.batch.bind(n) for n in ("qpos", "qvel", "qacc_warmstart")]
        self.ctrl = self.batch.bind("ctrl")
        self.iterations = self.batch.bind("solver_niter")
        self.socket = self.batch.bind("mocap_pos")[:, 0]
        self.socket[:] = scene.nominal
        self.turn = self.batch.bind("mocap_quat")[:, 0]
        self.still = self.batch.state[0].copy()
        self.geometry = {name: self.batch.expand(name) for name in scene.geometry}
        self.friction = self.batch.expand("geom_friction")
        self.gain, self.bias = map(self.batch.expand, ("actuator_gainprm", "actuator_biasprm"))
        self.shape_now = np.zeros(size, np.int32)
        self.friction_now = np.full(size, np.nan, np.float32)
        self.gains_now = np.ones((size, 2), np.float32)
        self.substeps = round(CONTROL_DT / scene.model.opt.timestep)

    def set_surroundings(self, shape, offset, yaw, friction, gains):
        """Writes only the model fields that changed: shapes rarely do, others only at resets."""
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
        changed = np.flatnonzero((gains != self.gains_now).any(axis=1))
        if changed.size:
            model, factors = self.scene.model, gains[changed, None]
            self.gain[changed, :, 0] = model.actuator_gainprm[:, 0] * factors[..., 0]
            self.bias[changed, :, 1:3] = model.actuator_biasprm[:, 1:3] * factors
            self.gains_now[changed] = gains[changed]
        np.add(self.scene.nominal[:2], offset, out=self.socket[:, :2])
        half = yaw.astype(float) / 2
        self.turn[:, 0], self.turn[:, 3] = np.cos(half), np.sin(half)

    def step(self, motion, setpoint, moved, contacts, solver):
        """Writes to `moved` where a control step takes `motion`, and which limits it met."""
        for own, given in zip(self.motion, motion, strict=True):
            own[:] = given
        self.ctrl[:] = setpoint
        broken = ~np.isfinite(self.batch.state).all(axis=1)
        self.batch.state[broken] = self.still
        before = self.overflows()
        self.batch.step(nstep=self.substeps)
        contacts[:] = self.overflows() != before
        solver[:] = self.iterations.max(axis=1) >= self.scene.model.opt.iterations
        for own, wanted in zip(self.motion, moved, strict=True):
            wanted[:] = own
            wanted[broken] = np.nan

    def overflows(self):
        """[size] how often MuJoCo has warned since the pool was made."""
        return self.batch.warning[:, _OVERFLOWS, _NUMBER].sum(axis=1)


def _simulate(scene, pools, inputs, outputs):
    lead = inputs[0].shape
    size = inputs[0].size
    flat = [array.reshape(size, *array.shape[len(lead) :]) for array in (*inputs, *outputs)]
    free = pools.setdefault(size, [])
    # A batch serves one thread at a time; concurrent calls, as of several devices, get their own.
    try:
        pool = free.pop()
    except IndexError:
        pool = _Pool(scene, size)
    try:
        pool.set_surroundings(*flat[:5])
        pool.step(flat[5:8], flat[8], flat[9:12], *flat[12:])
    finally:
        free.append(pool)


def _digest(scene):
    model = np.zeros(mujoco.mj_sizeModel(scene.model), np.uint8)
    mujoco.mj_saveModel(scene.model, None, model)
    digest = hashlib.sha256(model.tobytes())
    for table in (*scene.geometry.values(), scene.part_geoms, scene.nominal):
        digest.update(table.tobytes())
    return digest.hexdigest()[:16]
