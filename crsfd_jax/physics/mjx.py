"""MJX: MuJoCo's physics as JAX operations, for accelerators, and as a reference on a CPU."""

import contextlib
import io

import jax
import jax.numpy as jnp
import numpy as np

with contextlib.redirect_stdout(io.StringIO()):  # It prints that the optional warp is missing.
    from mujoco import mjx

from crsfd_jax.physics.interface import CONTROL_DT, Engine, PhysicsState, Surroundings
from crsfd_jax.scene.build import Scene


def make(scene: Scene, impl: str = "jax") -> Engine:
    """MJX with impl "jax" or "warp"."""
    model = mjx.put_model(scene.model, impl=impl)
    blank = mjx.make_data(scene.model, impl=impl)
    tables = {name: jnp.asarray(table, jnp.float32) for name, table in scene.geometry.items()}
    substeps = round(CONTROL_DT / scene.model.opt.timestep)

    def simulate(state: PhysicsState, around: Surroundings, setpoint: jax.Array) -> PhysicsState:
        geometry = {name: table[around.shape] for name, table in tables.items()}
        friction = model.geom_friction.at[np.asarray(scene.part_geoms), 0].set(around.friction)
        own = model.tree_replace({**geometry, "geom_friction": friction})
        place = jnp.asarray(scene.nominal, jnp.float32).at[:2].add(around.socket_offset)
        data = blank.replace(
            qpos=state.qpos,
            qvel=state.qvel,
            qacc_warmstart=state.warmstart,
            ctrl=setpoint,
            mocap_pos=place[None],
        )
        data = jax.lax.fori_loop(0, substeps, lambda _, d: mjx.step(own, d), data)
        return PhysicsState(qpos=data.qpos, qvel=data.qvel, warmstart=data.qacc_warmstart)

    return Engine(name="mjx" if impl == "jax" else impl, step=jax.vmap(simulate))
