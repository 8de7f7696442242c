"""Limits of the engines are told as MuJoCo alone tells them, counted, and put in words."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import probe_env
import pytest

from crsfd_jax import algorithms, config
from crsfd_jax.physics import native
from crsfd_jax.scene import build
from crsfd_jax.training import chunk, train_step, troubles

COUNT = 60
CAP = 16
"""Contacts that MJX keeps."""
SUBSTEPS = 20
OVERFLOWS = mujoco.mjtWarning.mjWARN_CONTACTFULL, mujoco.mjtWarning.mjWARN_CNSTRFULL


@pytest.fixture(scope="module")
def pushed(at_rest, around):
    """(state, surroundings, setpoint): pegs in the air, and others pushed into socket walls."""
    rng = np.random.default_rng(0)
    inside = np.arange(COUNT) % 3 > 0
    low, high = np.where(inside, [[-0.03], [-0.002]], [[0.01], [0.03]])
    side = np.where(inside, 0.01, 0.02)[:, None]
    position = np.column_stack([side * rng.uniform(-1, 1, (COUNT, 2)), rng.uniform(low, high)])
    setpoint = np.column_stack([position, np.zeros((COUNT, 3))]).astype(np.float32)
    return at_rest(position), around(np.arange(COUNT) % 5, friction=0.8), jnp.asarray(setpoint)


def simulated(scene, state, surroundings, setpoint, i):
    """MuJoCo alone: contacts of each physics step, overflows, iterations of the last step."""
    model = scene.model.__copy__()
    for name, table in scene.geometry.items():
        getattr(model, name)[:] = table[surroundings.shape[i]]
    model.geom_friction[scene.part_geoms, 0] = surroundings.friction[i]
    data = mujoco.MjData(model)
    data.qpos, data.ctrl = state.qpos[i], setpoint[i]
    data.mocap_pos[0] = scene.nominal
    data.mocap_pos[0, :2] += surroundings.socket_offset[i]
    contacts = []
    for _ in range(SUBSTEPS):
        mujoco.mj_step(model, data)
        contacts.append(data.ncon)
    return contacts, sum(data.warning[w].number for w in OVERFLOWS), data.solver_niter.max()


def test_mjx_tells_whose_contacts_are_more_than_it_keeps(scene, mjx_engine, pushed):
    _, limits = mjx_engine.advance(*pushed)
    contacts = np.array([simulated(scene, *pushed, i)[0] for i in range(COUNT)])
    # What MJX leaves out moves the peg elsewhere, so only the first step has the same contacts.
    more, fewer = contacts[:, 0] > CAP + 1, contacts.max(axis=1) < CAP - 1
    full = np.asarray(limits.contacts)
    assert full[more].all() and not full[fewer].any()
    assert (more & (contacts[:, -1] < CAP)).sum() >= 3 and more.sum() >= 10 and fewer.sum() >= 10
    assert limits.solver is None


def test_native_tells_whose_solver_used_up_its_iterations(scene, native_engine, pushed):
    _, limits = native_engine.advance(*pushed)
    iterations = np.array([simulated(scene, *pushed, i)[2] for i in range(COUNT)])
    wanted = iterations == scene.model.opt.iterations
    assert 3 <= wanted.sum() <= COUNT - 3
    np.testing.assert_array_equal(limits.solver, wanted)
    assert not limits.contacts.any()


def test_native_tells_whose_contacts_do_not_fit_in_memory(pushed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file in the working folder.
    from_file = mujoco.MjSpec.from_file

    def cramped(path):
        spec = from_file(path)
        spec.memory = 28_000
        return spec

    monkeypatch.setattr(mujoco.MjSpec, "from_file", staticmethod(cramped))
    scene = build._build.__wrapped__(config.Scene(), config.SHAPES)
    rows, wanted = [], []
    for i in range(COUNT):
        try:
            wanted.append(simulated(scene, *pushed, i)[1] > 0)
            rows.append(i)
        except mujoco.FatalError:  # Even less memory than for a warning.
            pass
    own = jax.tree.map(lambda leaf: jnp.asarray(leaf)[np.array(rows)], pushed)
    engine = native.make(scene)
    for _ in range(2):
        np.testing.assert_array_equal(engine.advance(*own)[1].contacts, wanted)
    assert 3 <= sum(wanted) <= len(wanted) - 3


def test_steps_that_met_a_limit_are_counted_for_each_seed():
    options = probe_env.config()
    learner = train_step.make(probe_env.make(), algorithms.load("sacfd"), options)
    keys = jax.vmap(jax.random.key)(jnp.arange(3))
    states = jax.vmap(lambda key: learner.init(key, probe_env.preparation()))(keys)
    _, counts = chunk.make(learner, 12)(states, jnp.int32(0))
    assert (counts["solver_limit"] > 0).all() and (counts["contact_limit"] > 0).any()
    np.testing.assert_array_equal(counts["solver_limit"], counts["successes"])
    timeouts = counts["episodes"] - counts["successes"]
    np.testing.assert_array_equal(counts["contact_limit"], timeouts)


def table(contacts, solver):
    """Two evaluations of two seeds."""
    return {
        "env_steps": np.array([500, 500, 1000, 1000]),
        "seed": np.array([7, 8, 7, 8]),
        "env/contact_limit": np.array(contacts),
        "env/solver_limit": np.array(solver),
    }


def test_what_was_met_is_said_and_nothing_where_nothing_was():
    assert troubles.words(table([1, 0, 0, 2], [0, 0, 0, 201])) == (
        "contacts filled their room in 3, the solver used up its iterations in 201 "
        "of 2,000 control steps"
    )
    assert troubles.words(table([0] * 4, [0, 0, 0, 200])) == ""
    unknown = [np.nan] * 4
    assert troubles.words(table([1200, 0, 0, 0], unknown)) == (
        "contacts filled their room in 1,200 of 2,000 control steps"
    )
    assert troubles.words(table([0] * 4, unknown)) == ""
    broken = table([0] * 4, unknown) | {"env/nonfinite": np.array([0, 0, 1, 0])}
    assert troubles.words(broken) == "the simulation broke down in 1 of 2,000 control steps"
    older = {name: table([0] * 4, unknown)[name] for name in ("env_steps", "seed")}
    assert troubles.words(older) == ""


def test_each_seed_that_diverged_is_named_with_its_first_such_step():
    rows = table([0] * 4, [0] * 4)
    assert troubles.diverged(rows) == []
    assert troubles.diverged(rows | {"train/diverged": np.array([0, 1, 1, 1])}) == [
        "seed 7 diverged at 1,000 steps",
        "seed 8 diverged at 500 steps",
    ]
