"""Host calls against numpy, and the C engine that uses them against plain mj_step."""

import os
import subprocess
import sys
import threading
import types

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from crsfd_jax import config
from crsfd_jax.physics import host_call, native
from crsfd_jax.physics.interface import PhysicsState, Surroundings
from crsfd_jax.scene import build, kinematics, randomize

DTYPES = ("bool", "int32", "float32")
SHAPES = ((1,), (2, 3), (0, 3))


def like(x, dtype=None):
    return jax.ShapeDtypeStruct(x.shape, dtype or x.dtype)


def reverse_and_count(inputs, outputs):
    """Reverses the last axis, and counts its elements that are not zero."""
    outputs[0][...] = inputs[0][..., ::-1]
    outputs[1][...] = np.count_nonzero(inputs[0], axis=-1)


def reversed_and_counted(x):
    counts = jax.ShapeDtypeStruct(x.shape[:-1], jnp.int32)
    return host_call.call("reverse_and_count", reverse_and_count, (like(x), counts), x)


def add_twice(inputs, outputs):
    outputs[0][...] = inputs[0] + 2 * inputs[1]


def added_twice(x, y):
    return host_call.call("add_twice", add_twice, (like(x),), x, y)[0]


@pytest.fixture(params=["handler", "callback"])
def route(request, monkeypatch):
    """Both ways to the host: XLA's interface, and the one for other versions and backends."""
    if request.param == "callback":
        monkeypatch.setattr(host_call, "_speaks_our_version", lambda: False)


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [*((dtype, (4, 1, 6)) for dtype in DTYPES), *(("float32", shape) for shape in SHAPES)],
)
def test_a_call_gives_what_numpy_gives_for_every_dtype_and_shape(dtype, shape):
    x = jnp.asarray(np.random.default_rng(0).integers(0, 3, shape), dtype)
    got, count = jax.jit(reversed_and_counted)(x)
    assert got.dtype == jnp.dtype(dtype)
    np.testing.assert_array_equal(np.asarray(got), np.asarray(x)[..., ::-1])
    np.testing.assert_array_equal(count, np.count_nonzero(np.asarray(x), axis=-1))


def test_scalars_go_in_and_out(route):
    assert jax.jit(added_twice)(jnp.float32(1), jnp.float32(3)) == 7


def test_leading_axes_of_vmaps_are_the_same_for_all_arguments(route):
    x, y = np.arange(24.0).reshape(2, 3, 4), np.arange(8.0).reshape(2, 4)
    once = jax.jit(jax.vmap(added_twice, in_axes=(0, None)))(x[0], y[0])
    np.testing.assert_array_equal(once, x[0] + 2 * y[0])
    twice = jax.jit(jax.vmap(jax.vmap(added_twice, in_axes=(0, None))))(x, y)
    np.testing.assert_array_equal(twice, x + 2 * y[:, None])
    last = jax.jit(jax.vmap(added_twice, in_axes=(2, None), out_axes=1))(x, 1.0 + 0 * x[..., 0])
    np.testing.assert_array_equal(last, np.moveaxis(x, 2, 1) + 2)


def test_a_call_works_inside_scans_conditions_and_vmapped_loops(route):
    x = np.arange(4.0, dtype=np.float32)
    scan = jax.jit(lambda x: jax.lax.scan(lambda c, y: (added_twice(c, y), c), x, jnp.ones((3, 4))))
    last, before = scan(x)
    np.testing.assert_array_equal(last, x + 6)
    np.testing.assert_array_equal(before, x + 2 * np.arange(3)[:, None])

    def branch(take, x):
        return jax.lax.cond(take, added_twice, lambda x, y: -x, x, 10 * x)

    assert [float(jax.jit(branch)(take, 1.0 * x)[1]) for take in (True, False)] == [21, -1]
    np.testing.assert_array_equal(jax.jit(jax.vmap(branch))(x > 1, x), np.where(x > 1, 21 * x, -x))

    def count_up(c):
        return jax.lax.while_loop(lambda c: c < 4, lambda c: added_twice(c, 0 * c + 1), c)

    np.testing.assert_array_equal(jax.jit(jax.vmap(count_up))(x), [4, 5, 4, 5])


def test_an_exception_becomes_an_error_of_the_program_and_the_next_call_works():
    def check(inputs, outputs):
        if inputs[0] < 0:
            raise ArithmeticError(f"got {inputs[0]}, must not be negative")
        outputs[0][...] = inputs[0]

    run = jax.jit(lambda x: host_call.call("check", check, (like(x),), x)[0] + 1)
    with pytest.raises(jax.errors.JaxRuntimeError, match=r"got -2\.0, must not be negative"):
        jax.block_until_ready(run(-2.0))
    assert run(3.0) == 4


def test_inputs_are_read_only():
    def spoil(inputs, outputs):
        inputs[0][...] = 0

    with pytest.raises(jax.errors.JaxRuntimeError, match="read-only"):
        jax.block_until_ready(host_call.call("spoil", spoil, (like(jnp.ones(3)),), jnp.ones(3)))


def test_another_dtype_is_refused():
    with pytest.raises(ValueError, match="got dtype int4, allowed: bool, int32, float32"):
        added_twice(jnp.ones(2, jnp.int4), jnp.ones(2, jnp.int4))


def test_another_version_of_the_interface_is_noticed(monkeypatch):
    assert host_call._speaks_our_version()
    monkeypatch.setattr(host_call, "_VERSION", (1, 0))
    with pytest.warns(UserWarning, match=r"FFI version \(0, 3\), .* written for \(1, 0\)"):
        assert not host_call._speaks_our_version.__wrapped__()


def python(code, *args, **env):
    done = subprocess.run(
        [sys.executable, "-c", code, *args],
        env={**os.environ, "JAX_PLATFORMS": "cpu", **env},
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


CACHED = """
import sys, time
import jax, jax.numpy as jnp
from crsfd_jax.physics import host_call

jax.config.update("jax_compilation_cache_dir", sys.argv[1])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
hits = []
listen = lambda event, **_: hits.append(event) if event.endswith("cache_hits") else None
jax.monitoring.register_event_listener(listen)

def slow_add(inputs, outputs):
    time.sleep(0.02)
    outputs[0][...] = inputs[0] + float(sys.argv[2])

def add(x, _):
    like = jax.ShapeDtypeStruct(x.shape, x.dtype)
    return host_call.call("slow_add", slow_add, (like,), x)[0] @ jnp.eye(300), None

x = jnp.zeros((300, 300))
run = jax.jit(lambda x: jax.lax.scan(add, x, None, length=20)[0].mean())
lowered = run.lower(x)
hits.clear()
compiled = lowered.compile()
print(len(hits), compiled(x))
# Large enough to run on another thread, and left running: the process must not hang at its end.
compiled(x)
"""


def test_a_second_process_finds_the_program_in_the_cache_and_calls_its_own_function(tmp_path):
    assert python(CACHED, str(tmp_path), "1") == ["0", "20.0"]
    assert python(CACHED, str(tmp_path), "2") == ["1", "40.0"]


@pytest.fixture(scope="module")
def world():
    """An engine, and simulations of all shapes that press their pegs on and into sockets."""
    scene = build.build(config.Scene())
    rng, count = np.random.default_rng(3), 20
    start = randomize.start_pool(kinematics.chain(scene), size=count)
    state = PhysicsState(qpos=start, qvel=0 * start, warmstart=0 * start)
    around = Surroundings(
        shape=np.arange(count, dtype=np.int32) % len(scene.shapes),
        socket_offset=rng.uniform(-0.004, 0.004, (count, 2)).astype(np.float32),
        friction=rng.uniform(0.1, 0.9, count).astype(np.float32),
        socket_yaw=rng.uniform(-0.05, 0.05, count).astype(np.float32),
    )
    setpoint = np.zeros((count, 6), np.float32)
    setpoint[:, :2] = around.socket_offset + rng.uniform(-0.002, 0.002, (count, 2))
    setpoint[:, 2] = -0.02
    engine = native.make(scene)
    step = jax.jit(engine.step)
    for _ in range(15):
        state = step(state, around, setpoint)
    return types.SimpleNamespace(
        scene=scene, engine=engine, step=step, state=state, around=around, setpoint=setpoint
    )


def plain_step(world, i):
    """One control step of simulation i by mj_step, and the contacts at its end."""
    scene, state, around = world.scene, world.state, world.around
    model = scene.model.__copy__()
    for name, table in scene.geometry.items():
        getattr(model, name)[:] = table[around.shape[i]]
    model.geom_friction[scene.part_geoms, 0] = around.friction[i]
    data = mujoco.MjData(model)
    data.qpos, data.qvel, data.qacc_warmstart = state.qpos[i], state.qvel[i], state.warmstart[i]
    data.ctrl = world.setpoint[i]
    data.mocap_pos[0] = scene.nominal
    data.mocap_pos[0, :2] += around.socket_offset[i]
    mujoco.mju_axisAngle2Quat(data.mocap_quat[0], [0, 0, 1], around.socket_yaw[i])
    for _ in range(round(0.1 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return PhysicsState(qpos=data.qpos, qvel=data.qvel, warmstart=data.qacc_warmstart), data.ncon


def assert_equal_states(got, wanted):
    jax.tree.map(np.testing.assert_array_equal, jax.tree.map(np.asarray, got), wanted)


def test_the_engine_takes_the_steps_of_mj_step_for_every_shape_friction_and_place(world):
    wanted, contacts = zip(*(plain_step(world, i) for i in range(20)), strict=True)
    assert np.count_nonzero(contacts) >= 15
    wanted = jax.tree.map(lambda *rows: np.stack(rows).astype(np.float32), *wanted)
    assert_equal_states(world.step(world.state, world.around, world.setpoint), wanted)


def test_simulations_under_a_vmap_are_those_of_one_batch(world):
    def fold(tree):
        return jax.tree.map(lambda x: np.asarray(x).reshape(4, 5, *x.shape[1:]), tree)

    arguments = (world.state, world.around, world.setpoint)
    wanted = fold(world.step(*arguments))
    assert_equal_states(jax.jit(jax.vmap(world.engine.step))(*fold(arguments)), wanted)
    single = jax.tree.map(lambda x: x[7], arguments)
    assert_equal_states(world.step(*single), jax.tree.map(lambda x: x[1, 2], wanted))


def test_a_step_does_not_depend_on_what_was_simulated_before_not_even_on_a_breakdown(
    world, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    wanted = jax.tree.map(np.asarray, world.step(world.state, world.around, world.setpoint))
    broken = world.state.replace(qvel=world.state.qvel.at[3].set(jnp.nan))
    other = world.around.replace(
        shape=world.around.shape[::-1], friction=world.around.friction[::-1]
    )
    got = jax.tree.map(np.asarray, world.step(broken, world.around, world.setpoint))
    for mine, theirs in zip(jax.tree.leaves(got), jax.tree.leaves(wanted), strict=True):
        assert np.isnan(mine[3]).all()
        np.testing.assert_array_equal(np.delete(mine, 3, 0), np.delete(theirs, 3, 0))
    assert not list(tmp_path.iterdir()), "MuJoCo met a NaN and logged it"
    world.step(world.state, other, -world.setpoint)
    assert_equal_states(world.step(world.state, world.around, world.setpoint), wanted)


def test_programs_on_several_threads_do_not_disturb_each_other(world):
    setpoints = [world.setpoint * scale for scale in (1, 0.9, 0.8)]
    run = jax.jit(
        lambda setpoint: jax.lax.fori_loop(
            0, 10, lambda _, state: world.engine.step(state, world.around, setpoint), world.state
        )
    )
    wanted = [jax.tree.map(np.asarray, run(setpoint)) for setpoint in setpoints]
    got = [None] * 3

    def work(i):
        got[i] = jax.block_until_ready(run(setpoints[i]))

    threads = [threading.Thread(target=work, args=(i,)) for i in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for mine, theirs in zip(got, wanted, strict=True):
        assert_equal_states(mine, theirs)


SHARDED = """
import threading
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec as P
from crsfd_jax.physics import host_call

# Passes only once two calls are under way at the same time.
both = threading.Barrier(2)

def double(inputs, outputs):
    both.wait(20)
    outputs[0][...] = 2 * inputs[0]

def doubled(x):
    return host_call.call("double", double, (jax.ShapeDtypeStruct(x.shape, x.dtype),), x)[0]

devices = P("d")
mesh = Mesh(np.array(jax.devices()), ("d",))
x = jax.device_put(jnp.arange(8.0), NamedSharding(mesh, devices))
split = jax.shard_map(doubled, mesh=mesh, in_specs=devices, out_specs=devices, check_vma=False)
print(*(float(jax.jit(run)(x) @ jnp.arange(8.0)) for run in (doubled, split)))
"""


def test_two_devices_call_at_the_same_time():
    two = "--xla_force_host_platform_device_count=2"
    assert python(SHARDED, XLA_FLAGS=two) == ["280.0", "280.0"]
