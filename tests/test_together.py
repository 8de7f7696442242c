"""Runs that share a program are the runs that they would be by themselves."""

import contextlib
import dataclasses
import shutil
import signal
import subprocess
import sys

import fault_runs
import jax
import numpy as np
import probe_env
import pytest
from test_devices import assert_equal, run, start
from test_divergence import poisoned

from crsfd_jax.config import Config, Evaluation, Potential
from crsfd_jax.demos import builtin
from crsfd_jax.errors import UserError
from crsfd_jax.interrupt import Interrupt
from crsfd_jax.options import together
from crsfd_jax.options.shapes import GRIDS
from crsfd_jax.options.smoke import smoke_sized
from crsfd_jax.storage import artefacts, checkpoints, metrics
from crsfd_jax.training import program, trainer

PAIR = (
    Config(smoke=True, shape="3,1", shift=0.008, seed=5, seeds=1),
    Config(smoke=True, shape="0,plus=.#./###/.#.", shift=0.0, seeds=2),
)


def small(config):
    """Of a size that compiles in seconds."""
    return dataclasses.replace(
        smoke_sized(config),
        envs=8,
        sac=dataclasses.replace(
            config.sac, hidden=(8,), batch_size=4, updates_per_step=1, warmup_steps=8
        ),
        replay=dataclasses.replace(config.replay, capacity=256),
        potential=Potential(steps=20, hidden=(8,)),
        evaluation=Evaluation(every=256, episodes=6),
    )


@pytest.fixture(scope="module")
def programs():
    """Programs of two runs together and of each alone."""
    configs, demos = [small(config) for config in PAIR], builtin.load("builtin")
    made = [program.build(chosen, demos) for chosen in (configs, configs[:1], configs[1:])]
    return made


def numbers(tree):
    leaves = jax.tree_util.tree_flatten_with_path(tree)[0]
    return {
        jax.tree_util.keystr(path): np.asarray(
            jax.random.key_data(leaf) if jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)
            else leaf
        )
        for path, leaf in leaves
    }  # fmt: skip


def joined(one, other):
    return {name: np.concatenate([one[name], other[name]]) for name in one}


def test_each_run_has_its_own_shapes_shift_and_seeds(programs):
    both, one, other = (made.start(made.own) for made in programs)
    assert both.env.around.shape.shape[0] == 3
    assert_equal(numbers(both), joined(numbers(one), numbers(other)))
    offset = np.abs(np.asarray(both.env.around.socket_offset))
    assert 0.002 < offset[0].max() <= 0.004 and (offset[1:] == 0).all()
    # With a moved hole demonstrations only fit the potential.
    priority = np.asarray(both.replay.priority)[:, : both.replay.num_demos]
    assert (priority[0] == 0).all() and (priority[1:] > 0).all()
    drawn = [set(np.asarray(rows).tolist()) for rows in both.env.around.shape]
    assert drawn[0] == {1, 3} and drawn[1] | drawn[2] == {0, len(GRIDS)}


def test_new_episodes_and_evaluations_are_of_the_runs_own_task(programs):
    begun = [made.start(made.own) for made in programs]
    played = [
        made.evaluate(states.agent.actor, made.own, np.int32(0))
        for made, states in zip(programs, begun, strict=True)
    ]
    both, one, other = map(numbers, played)
    np.testing.assert_array_equal(both[".shape"], joined(one, other)[".shape"])
    assert (begun[2].env.physics.qpos[0] != begun[2].env.physics.qpos[1]).any(axis=-1).all()
    later = programs[2].evaluate(begun[2].agent.actor, programs[2].own, np.int32(1024))
    of_seeds = [*other[".shape"], *numbers(later)[".shape"]]
    assert len({tuple(drawn) for drawn in of_seeds}) == len(of_seeds) == 4, "not fresh"
    advanced = [
        made.advance(states, made.own, np.int32(0))[0]
        for made, states in zip(programs, begun, strict=True)
    ]
    both, one, other = (numbers(states.env.around) for states in advanced)
    assert_equal(both, joined(one, other))
    began_in_it = np.asarray(advanced[0].env.age) < program.CHUNK_STEPS
    assert began_in_it.any(axis=1).all()


def lowered(config):
    """The programs of a run as text: to start, to evaluate, to advance."""
    made = program.build([small(config)], builtin.load("builtin"))
    own, step = made.own, np.int32(0)
    states = jax.eval_shape(made.start, own)
    yield made.start.lower(own).as_text()
    yield made.evaluate.lower(states.agent.average_actor, own, step).as_text()
    yield made.advance.lower(states, own, step).as_text()


def test_another_task_and_other_seeds_need_no_other_program():
    one = Config(smoke=True, shape="3", shift=0.008, seed=5, seeds=2, out="one")
    other = dataclasses.replace(one, shape="0", shift=0.0, seed=0, out="other")
    longer = dataclasses.replace(one, mdp=dataclasses.replace(one.mdp, horizon=7))
    first = list(lowered(one))
    assert first == list(lowered(other))
    assert first[0] != next(lowered(longer))


@pytest.mark.parametrize(
    ("change", "answer"),
    [
        ({"algorithm": "sac"}, "--algorithm: got crsfd and sac, allowed to differ beside --and"),
        ({"potential": Potential(free_space_weight=1.0)}, "--potential.free-space-weight: got"),
        ({"shape": "3,1,2"}, "--shape: got 3,1 and 3,1,2, allowed beside --and: as many"),
        ({"out": "./runs/a"}, "--out: got .*runs/a twice"),
    ],
)
def test_runs_that_cannot_share_a_program_are_refused(change, answer):
    first = dataclasses.replace(PAIR[0], out="runs/a")
    other = dataclasses.replace(first, **({"out": "runs/b"} | change))
    with pytest.raises(UserError, match=answer):
        together.require_alike([first, other])


def test_runs_that_differ_in_their_task_and_place_alone_can():
    other = dataclasses.replace(PAIR[1], out="x", target=0.5, clips=True, log="wandb")
    together.require_alike([PAIR[0], dataclasses.replace(other, steps=PAIR[0].steps)])
    with pytest.raises(UserError, match=r"--steps: got 300000 and 40000.*auto goes by the shift"):
        together.require_alike([PAIR[0], other])


def test_a_wrong_pair_ends_with_one_line_and_exit_code_2(tmp_path):
    words = [
        "--smoke",
        "--out",
        "a",
        "--and",
        "--smoke",
        "--shape",
        "1",
        "--sac.gamma",
        "0.97",
        "--out",
        "b",
    ]
    command = [sys.executable, "-m", "crsfd_jax.train", *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=60)
    assert (done.returncode, done.stdout) == (2, "") and len(done.stderr.splitlines()) == 1
    assert "--sac.gamma: got 0.98 and 0.97" in done.stderr and not list(tmp_path.iterdir())


def trained_together(folder, *options, **changes):
    """Two runs of two seeds each: a and b."""
    code, out = run(f"{folder / 'a'},{folder / 'b'}", 2, *options, **changes)
    assert code == 0, out
    return out


def rows(folder, first):
    """Rows and parameters of the two seeds from a first one on, without the clock."""
    table = metrics.read(folder / "metrics.csv")
    chosen = (table["seed"] >= first) & (table["seed"] < first + 2)
    columns = {n: c[chosen] for n, c in table.items() if n not in metrics.WALL_CLOCK_COLUMNS}
    with np.load(folder / "policy.npz") as file:
        own = slice(None) if len(file[file.files[0]]) == 2 else slice(first, first + 2)
        return columns | {name: file[name][own] for name in file.files}


@pytest.fixture(scope="module")
def apart(tmp_path_factory):
    """A run of four seeds."""
    folder = tmp_path_factory.mktemp("apart") / "run"
    assert run(folder, 4)[0] == 0
    return folder


def test_each_run_leaves_what_it_would_leave_alone(apart, tmp_path):
    said = trained_together(tmp_path, devices=2)
    assert "seeds     4, evenly on 2 of 2 devices" in said
    for name, first in (("a", 0), ("b", 2)):
        assert_equal(rows(tmp_path / name, first), rows(apart, first))
        assert artefacts.read_config(tmp_path / name).seed == first
    assert said.count("final success") == 2


def test_runs_stopped_together_go_on_together_or_alone(apart, tmp_path):
    process = start(f"{tmp_path / 'a'},{tmp_path / 'b'}", 2)
    fault_runs.wait_for(process, "compiled")
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=500)
    assert process.returncode == 75, out
    shutil.copytree(tmp_path / "a", tmp_path / "alone")
    assert "resumed at" in trained_together(tmp_path)
    code, out = run(tmp_path / "alone", 2)
    assert code == 0 and "resumed at" in out
    for name, first in (("a", 0), ("b", 2), ("alone", 0)):
        assert_equal(rows(tmp_path / name, first), rows(apart, first))


def test_runs_that_were_never_saved_together_are_not_mixed(tmp_path):
    assert run(tmp_path / "a", 2)[0] == 0
    before = (tmp_path / "a/metrics.csv").read_bytes()
    code, out = run(f"{tmp_path / 'a'},{tmp_path / 'b'}", 2)
    assert code == 2 and "no checkpoint of one step" in out and "Traceback" not in out
    assert (tmp_path / "a/metrics.csv").read_bytes() == before


@pytest.fixture(scope="module")
def probe():
    """Runs of one and of two seeds, and their program."""
    first = probe_env.config(seeds=1)
    configs = [first, dataclasses.replace(first, seed=1, seeds=2)]
    made = program.assemble(configs, lambda own: probe_env.make(), probe_env.preparation())
    return configs, made


def trained(probe, place, start=None):
    """Exit code and run folders a and b of the pair."""
    configs, made = probe
    with contextlib.ExitStack() as stack:
        folders = [
            stack.enter_context(artefacts.open_run(place / name, config, "probe", []))
            for name, config in zip("ab", configs, strict=True)
        ]
        interrupt = stack.enter_context(Interrupt())
        chosen = made._replace(start=start or made.start)
        return trainer.run(configs, chosen, folders, interrupt), *folders


def steps_made(folder):
    return set(metrics.read(folder.metrics)["env_steps"].tolist())


def test_a_run_without_a_seed_left_ends_where_it_would_alone(probe, tmp_path, capsys):
    begun = probe[1].start(probe[1].own)
    code, a, b = trained(probe, tmp_path, lambda own: poisoned(begun, "critic", np.array([1, 2])))
    assert code == 1 and "no seed counts" in capsys.readouterr().out.splitlines()[-1]
    assert steps_made(a) == {256, 512, 768, 1024} and steps_made(b) == {256}
    assert not list(a.path.glob("diverged-*"))
    states = probe[1].start(probe[1].own)
    for step in range(0, 64, 16):
        states, _ = probe[1].advance(states, probe[1].own, np.int32(step))
    for index in (1, 2):
        with np.load(b.path / f"diverged-seed{index}-step256.npz") as file:
            expected = jax.random.key_data(states.key[index])
            np.testing.assert_array_equal(file[".key"], expected)


@pytest.mark.parametrize(("step", "left"), [(16, False), (256, True)])
def test_a_stop_between_the_saves_of_two_runs_loses_nothing(
    probe, tmp_path, monkeypatch, step, left
):
    whole = trained(probe, tmp_path / "whole")[1:]
    save = checkpoints.save

    def cut_short(folder, *arguments):
        # The first one or the last one of b: a has its own by then.
        if folder.parent.name == "b" and arguments[0] == step:
            raise RuntimeError("killed")
        save(folder, *arguments)

    with monkeypatch.context() as patch, pytest.raises(RuntimeError, match="killed"):
        patch.setattr(checkpoints, "save", cut_short)
        trained(probe, tmp_path / "cut")
    assert (tmp_path / "cut" / "a" / "checkpoints" / str(step)).exists()
    assert any((tmp_path / "cut" / "b" / "checkpoints").glob("*")) == left
    code, *folders = trained(probe, tmp_path / "cut")
    assert code == 0
    for cut, other in zip(folders, whole, strict=True):
        one, same = metrics.read(cut.metrics), metrics.read(other.metrics)
        for name in one.keys() - set(metrics.WALL_CLOCK_COLUMNS):
            np.testing.assert_array_equal(one[name], same[name], err_msg=name)
