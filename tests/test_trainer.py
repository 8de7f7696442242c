"""Whole runs from the command line: what they leave, and that a stop loses nothing."""

import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from crsfd_jax import algorithms, cli
from crsfd_jax.config import ALGORITHMS, Config, Mdp, Potential, Replay, Sac, to_dict
from crsfd_jax.demos import builtin
from crsfd_jax.errors import UserError
from crsfd_jax.options.schedule import CHUNK_STEPS, evaluation_period, total_steps
from crsfd_jax.options.smoke import smoke_sized
from crsfd_jax.storage import artefacts, metrics
from crsfd_jax.sweeps import state
from crsfd_jax.training import trainer
from crsfd_jax.training.program import fitted

OPTIONS = ("--smoke", "--shape", "3", "--shift", "4mm")


def command(module, *arguments):
    return [sys.executable, "-m", f"crsfd_jax.{module}", *map(str, arguments)]


def finished(module, *arguments):
    done = subprocess.run(
        command(module, *arguments), capture_output=True, text=True, timeout=500, check=False
    )
    return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A run that was never stopped."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    code, out, err = finished("train", *OPTIONS, "--out", folder)
    assert code == 0, err
    assert "final success" in out.splitlines()[-1] and "95 % interval" in out.splitlines()[-1]
    return folder


def test_a_run_leaves_what_a_person_needs(whole):
    names = {entry.name for entry in whole.iterdir()}
    assert {"config.json", "metrics.csv", "curves.png", "policy.npz", "checkpoints"} <= names
    config = artefacts.read_config(whole)
    assert (config.shape, config.shift, config.smoke) == ("3", 0.004, True)
    table = metrics.read(whole / "metrics.csv")
    assert table["env_steps"].tolist() == [2048, 2048, 4096, 4096]
    assert table["seed"].tolist() == [0, 1, 0, 1]
    assert (table["env/nonfinite"] == 0).all()
    assert (table["eval/success_rate"] >= 0).all() and (table["eval/success_rate"] <= 1).all()
    speed = 2 * table["env_steps"] / table["time/wall_s"]
    np.testing.assert_allclose(table["time/env_steps_per_second"], speed, rtol=1e-6)


def test_a_stopped_run_continues_to_the_same_end(whole, tmp_path):
    folder = tmp_path / "stopped"
    arguments = command("train", *OPTIONS, "--out", folder)
    process = subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("compiled"):
            os.kill(process.pid, signal.SIGTERM)
    assert process.wait(timeout=200) == 75
    code, out, err = finished("train", *OPTIONS, "--out", folder)
    assert code == 0, err
    assert "resumed at" in out
    one, other = (metrics.read(path / "metrics.csv") for path in (whole, folder))
    for name in one.keys() - set(metrics.WALL_CLOCK_COLUMNS):
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    with np.load(whole / "policy.npz") as a, np.load(folder / "policy.npz") as b:
        for name in a.files:
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def test_a_finished_run_says_so_again_and_writes_no_checkpoint(whole):
    last = whole / "checkpoints" / str(4096 // 16)
    before = last.stat().st_mtime_ns, last.stat().st_ino
    code, out, _ = finished("train", *OPTIONS, "--out", whole)
    assert code == 0 and (last.stat().st_mtime_ns, last.stat().st_ino) == before
    assert "resumed at 4096 of 4096" in out and "compiling" not in out


def test_a_run_without_its_checkpoints_does_not_start_over(whole, tmp_path):
    copy = shutil.copytree(whole, tmp_path / "copy")
    shutil.rmtree(copy / "checkpoints")
    before = (copy / "metrics.csv").read_bytes()
    code, _, err = finished("train", *OPTIONS, "--out", copy)
    assert code == 2 and len(err.strip().splitlines()) == 1
    assert "holds no checkpoint, expected one of a run with the results in metrics.csv" in err
    assert (copy / "metrics.csv").read_bytes() == before


def test_a_run_without_its_results_does_not_go_on(whole, tmp_path):
    copy = shutil.copytree(whole, tmp_path / "copy")
    (copy / "metrics.csv").unlink()
    code, _, err = finished("train", *OPTIONS, "--steps", "8192", "--out", copy)
    assert code == 2 and len(err.strip().splitlines()) == 1
    assert "metrics.csv: holds no results, expected those of the run" in err
    assert not (copy / "metrics.csv").exists()


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("import nothing_of_this_name\n", "ModuleNotFoundError: No module named"),
        ("METHOD = Method(\n", "SyntaxError"),
        ("x = 1 / 0\n", "ZeroDivisionError: division by zero; correct the file"),
        ("", "METHOD: got None, expected a Method; define it"),
        ("METHOD = 3\n", "METHOD: got 3, expected a Method"),
    ],
)
def test_a_mistake_in_a_method_s_file_is_told_in_one_line(text, answer, tmp_path, monkeypatch):
    name = f"mistaken{abs(hash(text))}"
    (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.setattr(algorithms, "__path__", [*algorithms.__path__, str(tmp_path)])
    with pytest.raises(UserError) as error:
        algorithms.load(name)
    assert f"{name}.py: " in str(error.value) and answer in str(error.value)


@pytest.mark.parametrize(
    ("config", "answer"),
    [
        (Config(algorithm="rlpd", sac=Sac(critics=4)), "--sac.critics: got 4, but rlpd always has"),
        (
            Config(algorithm="crsfd_same_gamma", potential=Potential(gamma=0.9)),
            "--potential.gamma: got 0.9, but crsfd_same_gamma always has 0.98",
        ),
        (
            Config(algorithm="sac", replay=Replay(priority_exponent=0.5)),
            "--replay.priority-exponent: got 0.5, but sac always has 0.0",
        ),
        *(
            (
                Config(algorithm=name, replay=Replay(draw_demos=choice)),
                f"--replay.draw-demos: got {choice}, but {name} does not",
            )
            for name, choice in (("sac", "yes"), ("sqil", "no"), ("rlpd", "no"), ("bc", "no"))
        ),
        *(
            (
                Config(algorithm=name, sac=Sac(warmup="demos")),
                f"--sac.warmup: got demos, but {name}",
            )
            for name in ("sac", "bc")
        ),
        (Config(algorithm="bc", sac=Sac(warmup="random")), "bc does not act before"),
        *(
            (
                Config(algorithm=name, replay=Replay(demo_bonus=0.5)),
                f"--replay.demo-bonus: got 0.5, but {name} has no use",
            )
            for name in ("sac", "gail", "rlpd", "sqil", "bc")
        ),
        *(
            (
                Config(algorithm=name, potential=Potential(gamma=0.9)),
                f"--potential.gamma: got 0.9, but {name} has no use",
            )
            for name in ("sacfd", "rsgm", "gail", "bc")
        ),
        (Config(algorithm="bc", sac=Sac(tau=0.01)), "--sac.tau: got 0.01, but bc has no use"),
        (
            Config(algorithm="bc", replay=Replay(n_step=5)),
            "--replay.n-step: got 5, but bc has no use",
        ),
        (
            Config(algorithm="crsfd_no_free_space", potential=Potential(free_space_extent=2.0)),
            "--potential.free-space-extent: got 2.0, but crsfd_no_free_space has no use",
        ),
        (Config(mdp=Mdp(translation_scale=0.02)), "the action scale .*0.01.*, expected .*0.02"),
    ],
)
def test_what_a_method_or_the_demonstrations_fix_is_refused_before_a_folder_is_made(
    tmp_path, config, answer
):
    config = replace(config, out=str(tmp_path / "run"))
    with pytest.raises(UserError, match=answer):
        trainer.train([config], builtin.load("builtin"))
    assert not (tmp_path / "run").exists()


def test_what_a_method_sets_by_itself_is_not_refused():
    for name in ALGORITHMS:
        algorithms.refuse_unused(Config(algorithm=name, sac=Sac(gamma=0.97)))
        algorithms.refuse_unused(smoke_sized(Config(algorithm=name, smoke=True)))
    algorithms.refuse_unused(Config(algorithm="rsgm", potential=Potential(hidden=(8,))))
    algorithms.refuse_unused(Config(algorithm="crsfd_same_gamma", potential=Potential(steps=9)))


def test_a_target_decides_the_exit_code_and_may_change(whole):
    code, out, _ = finished("train", *OPTIONS, "--out", whole, "--target", "1")
    assert code == 1
    assert out.splitlines()[-1].endswith("target 1 missed")
    assert finished("train", *OPTIONS, "--out", whole)[0] == 0


def test_a_sweep_sees_which_run_is_finished(whole):
    config = smoke_sized(cli.parse(Config, OPTIONS))
    assert state.is_finished(whole, config)
    assert not state.is_finished(whole, replace(config, seed=7))


def test_other_options_do_not_touch_a_run(whole):
    before = (whole / "metrics.csv").read_bytes()
    code, _, err = finished("train", *OPTIONS, "--seed", "7", "--out", whole)
    assert code == 2
    assert len(err.strip().splitlines()) == 1 and "seed 0 -> 7" in err
    code, _, err = finished("train", *OPTIONS, "--sac.hidden", "64", "--out", whole)
    assert code == 2 and "sac.hidden 128 128 -> 64" in err
    assert (whole / "metrics.csv").read_bytes() == before


def test_a_policy_is_evaluated_on_another_task(whole):
    arguments = (whole, "--shape", "1", "--shift", "2mm", "--episodes", "7")
    code, out, err = finished("evaluate", *arguments)
    assert code == 0, err
    lines = out.splitlines()
    assert lines[0].startswith("shape 1, shift 2 mm")
    assert len(lines) == 4 and "of 14)" in lines[-1]


def test_sizes_of_a_run_are_whole_chunks():
    config = Config(steps=60_000, envs=64)
    assert total_steps(config) % CHUNK_STEPS == 0
    assert 0 <= total_steps(config) * config.envs - config.steps < CHUNK_STEPS * config.envs
    assert evaluation_period(config) * config.envs == config.evaluation.every
    assert fitted(config).replay.capacity == total_steps(config) * config.envs
    assert fitted(Config(steps=10**6)).replay.capacity == Config().replay.capacity


def test_a_run_that_goes_on_with_more_steps_keeps_its_buffer_unless_told_another():
    begun, longer = fitted(Config(steps=60_000)), Config(steps=120_000)
    assert fitted(longer, begun).replay.capacity == begun.replay.capacity < 120_000
    other = replace(longer, replay=Replay(capacity=32_000))
    assert fitted(other, begun).replay.capacity == 32_000
    # The capacity that it was begun with, of which it needed less then.
    again = replace(longer, replay=Replay(capacity=64_000))
    assert fitted(again, begun).replay.capacity == begun.replay.capacity


def test_steps_may_grow_whatever_the_buffer_was_fitted_to(tmp_path):
    kept = "buffer    2048 transitions a seed (as the run began; a new one of these steps has 4096)"
    for steps, said in ((2048, "prepared"), (4096, "resumed at 2048 of 4096 steps")):
        code, out, err = finished("train", *OPTIONS, "--steps", steps, "--out", tmp_path / "run")
        assert code == 0, err
        assert said in out and "buffer    2048 transitions" in out
        assert (kept in out) == (steps == 4096)
        assert f"steps     {steps} a seed, evaluated every 2048" in out
    assert metrics.read(tmp_path / "run" / "metrics.csv")["env_steps"].tolist()[::2] == [2048, 4096]


def test_config_survives_json(tmp_path):
    import json

    from crsfd_jax.options.stored import from_dict

    config = Config(shape="4", shift=0.006)
    assert from_dict(json.loads(json.dumps(to_dict(config)))) == config
