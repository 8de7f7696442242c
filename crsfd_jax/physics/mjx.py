"""MJX: MuJoCo's physics as JAX operations, for accelerators, and as a reference on a CPU."""

import contextlib
import copy
import functools
import io
from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

with contextlib.redirect_stdout(io.StringIO()):  # It prints that the optional warp is missing.
    from mujoco import mjx

from crsfd_jax.physics.interface import CONTROL_DT, Engine, Limits, PhysicsState, Surroundings
from crsfd_jax.scene.build import Scene

_UNKNOWN_TO_WARP = mujoco.mjtDisableBit.mjDSBL_MIDPHASE, mujoco.mjtDisableBit.mjDSBL_AUTORESET
"""Flags that switch off what Warp does not have, and that it refuses for being unknown."""
_CANDIDATES = 64
"""Contacts of an environment that Warp has room for before any are sorted out."""
Advance = Callable[[PhysicsState, Surroundings, jax.Array], tuple[PhysicsState, Limits]]


def make(scene: Scene, impl: str = "jax") -> Engine:
    """MJX with impl "jax" or "warp"."""
    compiled = _without(scene.model, _UNKNOWN_TO_WARP) if impl == "warp" else scene.model
    model = mjx.put_model(compiled, impl=impl)
    if impl == "warp":
        model = _quiet(model)
    tables = {
        name: jnp.asarray(table, jnp.float32).reshape(len(table), *getattr(model, name).shape)
        for name, table in scene.geometry.items()
    }
    substeps = round(CONTROL_DT / scene.model.opt.timestep)
    tells = impl == "jax"

    def actuators(around: Surroundings) -> dict[str, jax.Array]:
        if around.gains is None:
            return {}
        return {
            "actuator_gainprm": model.actuator_gainprm.at[:, 0].multiply(around.gains[0]),
            "actuator_biasprm": model.actuator_biasprm.at[:, 1:3].multiply(around.gains),
        }

    def simulate(blank, state: PhysicsState, around: Surroundings, setpoint: jax.Array):
        geometry = {name: table[around.shape] for name, table in tables.items()}
        friction = model.geom_friction.at[np.asarray(scene.part_geoms), 0].set(around.friction)
        own = model.tree_replace({**geometry, "geom_friction": friction, **actuators(around)})
        place = jnp.asarray(scene.nominal, jnp.float32).at[:2].add(around.socket_offset)
        yaw = jnp.float32(0) if around.socket_yaw is None else around.socket_yaw
        turn = jnp.zeros(4).at[0].set(jnp.cos(yaw / 2)).at[3].set(jnp.sin(yaw / 2))
        data = blank.replace(
            qpos=state.qpos,
            qvel=state.qvel,
            qacc_warmstart=state.warmstart,
            ctrl=setpoint,
            mocap_pos=place[None],
            mocap_quat=turn[None],
        )

        def physics_step(_, carry):
            data, full = carry
            data = mjx.step(own, data)
            return data, full | _are_full(data) if tells else full

        data, full = jax.lax.fori_loop(0, substeps, physics_step, (data, jnp.bool_(False)))
        after = PhysicsState(qpos=data.qpos, qvel=data.qvel, warmstart=data.qacc_warmstart)
        return after, Limits(contacts=full) if tells else Limits()

    def advance(
        state: PhysicsState, around: Surroundings, setpoint: jax.Array
    ) -> tuple[PhysicsState, Limits]:
        blank = mjx.make_data(
            compiled, impl=impl, naconmax=len(setpoint) * _CANDIDATES, njmax=compiled.njmax
        )
        return jax.vmap(functools.partial(simulate, blank))(state, around, setpoint)

    if impl == "warp":
        return Engine(name="warp", advance=_as_one_batch(advance))
    return Engine(name="mjx", advance=advance)


def _are_full(data: mjx.Data) -> jax.Array:
    """[] bool: all of the contacts that are kept, the deepest, are closer than their margin."""
    contact = data._impl.contact
    return (contact.dist < contact.includemargin).all()


def _as_one_batch(advance: Advance) -> Advance:
    """The step whose outer vmap axes become more environments of one call.

    Warp allocates its contacts for a whole batch, which must be known where they are allocated.
    """
    advance = jax.custom_batching.custom_vmap(advance)

    @advance.def_vmap
    def batched(axis_size, in_batched, *arguments):
        def merge(x, is_batched):
            x = x if is_batched else jnp.broadcast_to(x, (axis_size, *x.shape))
            return x.reshape(-1, *x.shape[2:])

        moved = advance(*jax.tree.map(merge, arguments, tuple(in_batched)))
        split = jax.tree.map(lambda x: x.reshape(axis_size, -1, *x.shape[1:]), moved)
        return split, jax.tree.map(lambda _: True, split)

    return advance


def _without(model: mujoco.MjModel, flags: tuple[int, ...]) -> mujoco.MjModel:
    """A copy of a model whose disable flags are off."""
    model = copy.copy(model)
    for flag in flags:
        model.opt.disableflags &= ~int(flag)
    return model


def _quiet(model: mjx.Model) -> mjx.Model:
    """Without Warp's lines about solver iterations, which are few on purpose, at every step."""
    from mujoco.mjx.third_party.mujoco_warp import OverflowType

    shown = model.opt._impl.warn_overflow & ~(OverflowType.ITERATIONS | OverflowType.LS_ITERATIONS)
    own = model.opt._impl.replace(warn_overflow=int(shown))
    return model.replace(opt=model.opt.replace(_impl=own))
