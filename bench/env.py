"""Control steps per second of each physics engine, peg in contact, as one JSON line.

Every engine runs as in training: a jitted scan over control steps of a batch. Beside it, and in
turn with it, MuJoCo's own batch steps the same model from the same states under the same setpoint.
"""

import contextlib
import dataclasses
import importlib.util
import itertools
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from importlib import metadata
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco.batch
import numpy as np
import tyro

from crsfd_jax import config
from crsfd_jax.physics import select
from crsfd_jax.physics.interface import CONTROL_DT, Engine, PhysicsState, Surroundings
from crsfd_jax.scene import build, kinematics

PRESS = (0.005, 0.0, -0.04, 0.0, 0.0, 0.0)
"""m and rad, a setpoint that presses the peg on the floor of the hole and against a wall."""
DEPTH = -0.0295
"""m, where the peg starts."""
SETTLING = 20
"""Control steps until the peg rests on the floor and the wall."""
PACKAGES = ("jax", "mujoco", "mujoco-mjx", "numpy")


def installed_engines() -> tuple[str, ...]:
    """Warp only where it is installed."""
    warp = ("warp",) if importlib.util.find_spec("warp") else ()
    return ("native", "mjx", *warp)


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure."""

    engines: tuple[str, ...] = dataclasses.field(default_factory=installed_engines)
    """Engines, one after the other: native, mjx, warp."""
    batch_sizes: tuple[int, ...] = (64, 320)
    """Numbers of environments, one after the other."""
    steps: int = 10
    """Control steps in a timed call."""
    rounds: int = 5
    """Timed calls of an engine and of the bare batch, in turn."""


class Contact(NamedTuple):
    """Arms that press their pegs against floor and wall."""

    state: PhysicsState
    around: Surroundings
    setpoint: jax.Array


def in_contact(scene: build.Scene, count: int) -> Contact:
    """The same settled contact in every environment."""
    tip = jnp.array([[0.0, 0.0, DEPTH]])
    qpos, _ = kinematics.inverse_kinematics(kinematics.chain(scene), tip, jnp.zeros((1, 3)))
    still = jnp.zeros_like(qpos)
    one = Contact(
        state=PhysicsState(qpos=qpos, qvel=still, warmstart=still),
        around=Surroundings(
            shape=jnp.zeros(1, jnp.int32), socket_offset=jnp.zeros((1, 2)), friction=jnp.ones(1)
        ),
        setpoint=jnp.array([PRESS]),
    )
    engine = select.make("native", scene)
    settled = jax.jit(roll, static_argnums=(0, 2))(engine, one, SETTLING)
    return jax.tree.map(lambda x: jnp.tile(x, (count, 1)[: x.ndim]), one._replace(state=settled))


def roll(engine: Engine, contact: Contact, steps: int) -> PhysicsState:
    """The state after some control steps."""

    def body(state, _):
        return engine.step(state, contact.around, contact.setpoint), None

    return jax.lax.scan(body, contact.state, length=steps)[0]


def bare_batch(scene: build.Scene, contact: Contact, steps: int) -> Callable[[], None]:
    """The same control steps by MuJoCo alone, without JAX and without copies between steps."""
    size, substeps = len(contact.setpoint), round(CONTROL_DT / scene.model.opt.timestep)
    batch = mujoco.batch.Batch(scene.model, size, nthread=0, persistent=True)
    names = {"qpos": "qpos", "qvel": "qvel", "qacc_warmstart": "warmstart"}
    starts = [(batch.bind(n), np.asarray(getattr(contact.state, f))) for n, f in names.items()]
    batch.bind("ctrl")[:] = np.asarray(contact.setpoint)

    def call():
        for field, start in starts:
            field[:] = start
        for _ in range(steps):
            batch.step(nstep=substeps)

    return call


def seconds(call: Callable[[], object]) -> float:
    """Wall time of one call until its result is there."""
    start = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - start


def rate(times: list[float], control_steps: int) -> dict[str, float]:
    """Control steps per second in the fastest and in the median round."""
    best, median = control_steps / min(times), control_steps / statistics.median(times)
    return {"best": round(best, 1), "median": round(median, 1)}


def measure(name: str, size: int, options: Options) -> dict:
    """One engine at one batch size against the bare batch."""
    scene = build.build(config.Scene())
    contact = in_contact(scene, size)
    run = jax.jit(roll, static_argnums=(0, 2))
    engine = select.make(select.resolve(name), scene)
    calls = (lambda: run(engine, contact, options.steps), bare_batch(scene, contact, options.steps))
    first = [seconds(call) for call in calls]
    rounds = [[seconds(call) for call in calls] for _ in range(options.rounds)]
    own, bare = (list(times) for times in zip(*rounds, strict=True))
    total = size * options.steps
    return {
        "engine": name,
        "batch_size": size,
        "control_steps_per_s": rate(own, total),
        "bare_batch_control_steps_per_s": rate(bare, total),
        "share_of_bare_batch": round(min(bare) / min(own), 3),
        "first_call_s": round(first[0], 2),
    }


def main(options: Options) -> None:
    """Prints the results of every engine and batch size."""
    pairs = itertools.product(options.engines, options.batch_sizes)
    # MJX prints a line when it finds no Warp.
    with contextlib.redirect_stdout(sys.stderr):
        results = [measure(name, size, options) for name, size in pairs]
    line = {
        "bench": "env",
        "results": results,
        "control_step_s": CONTROL_DT,
        "device": jax.devices()[0].device_kind,
        "cores": os.cpu_count(),
        "machine": platform.machine(),
        "versions": {package: metadata.version(package) for package in PACKAGES},
    }
    print(json.dumps(line))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
