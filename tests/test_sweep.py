"""Sweeps: what the experiments are, and that every cell is run once, whatever happens."""

import functools
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from crsfd_jax import algorithms, sweep
from crsfd_jax.config import ALGORITHMS, Config, Evaluation
from crsfd_jax.demos import builtin
from crsfd_jax.errors import STOPPED, UserError
from crsfd_jax.options.randomisation import TRAINING
from crsfd_jax.options.run_name import run_name
from crsfd_jax.storage import artefacts, metrics
from crsfd_jax.sweeps import attempt, cells, demonstrations, local_pool, slurm_array, state
from crsfd_jax.sweeps.attempt import Plan
from crsfd_jax.sweeps.grid import METHODS

ROOT = Path(__file__).parents[1]
FAKE = (sys.executable, str(Path(__file__).parent / "fake_train.py"))
SWEEP = """
import sys
from crsfd_jax import cli, sweep
cli.main(lambda argv: sweep.run(argv, command=%r))
""" % (FAKE,)  # noqa: UP031
SHAPES = ("1", "2", "3")
NAMES = [f"crsfd-shape{shape}-shift0mm-seed0x2-smoke" for shape in SHAPES]
STEPS = [1024, 2048, 3072, 4096]


@pytest.fixture
def file(tmp_path, monkeypatch) -> Path:
    """An experiment of three cells."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT), prepend=os.pathsep)
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "three.py"
    path.write_text(
        '"""Three shapes.\n\nMore."""\n'
        f'CELLS = tuple(("--smoke", "--shape", shape) for shape in {SHAPES})\n'
    )
    return path


@pytest.fixture
def out(tmp_path) -> Path:
    return tmp_path / "runs" / "three"


@functools.cache
def experiment(name: str) -> cells.Experiment:
    return cells.load(name)


def at_root() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def swept(file, *options) -> int:
    return sweep.run(["--experiment", str(file), *options], command=FAKE)


def started(file, *options) -> subprocess.Popen:
    command = [sys.executable, "-c", SWEEP, "--experiment", str(file), *options]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


def starts(out: Path, name: str) -> list[int]:
    path = out / name / "starts"
    return [int(pid) for pid in path.read_text().split()] if path.is_file() else []


def parent(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])


def wait_for(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "this never happened"
        time.sleep(0.02)


def assert_whole(out: Path, name: str):
    """Every row of every seed is there once."""
    table = metrics.read(out / name / "metrics.csv")
    rows = list(zip(table["env_steps"].tolist(), table["seed"].tolist(), strict=True))
    assert rows == [(steps, seed) for steps in STEPS for seed in range(2)]


@pytest.mark.parametrize("path", cells.available(), ids=lambda path: path.stem)
def test_every_cell_of_an_experiment_is_a_run_of_its_own(path):
    found = experiment(path.stem)
    assert found.description and len(found.cells) >= (2 if path.stem == "next_task" else 5)
    assert len({cell.name for cell in found.cells}) == len(found.cells)
    for cell in found.cells:
        assert cell.name.startswith(f"{cell.config.algorithm}-shape")
        algorithms.refuse_unused(cell.config)
        is_short = path.stem in ("early", "sensitivity", "reward_scale")
        is_short |= path.stem == "controls" and not cell.config.shift
        budget = Config().steps if is_short else 300_000
        if path.stem == "sensitivity" and cell.config.shift:
            budget *= 2
        assert cell.config.algorithm == "bc" or cell.config.steps == budget


def test_experiments_are_those_of_the_paper():
    def pairs(name, *options):
        return {
            tuple(getattr(cell.config, option) for option in options)
            for cell in experiment(name).cells
        }

    methods = {"crsfd", "sacfd", "sac", "bc", "rlpd", "rsgm", "pofd", "sqil", "gail", "gaifo"}
    arms = {"crsfd_no_free_space", "crsfd_same_gamma"}
    assert methods == set(METHODS) and methods | arms <= set(ALGORITHMS)
    assert pairs("setting1", "algorithm", "shape", "shift") == {
        (method, shape, 0.0) for method in methods for shape in "1234"
    }
    assert pairs("setting2", "algorithm", "shape", "shift") == {
        (method, shape, shift)
        for method in ("crsfd", "sacfd")
        for shape in "02"
        for shift in (0.004, 0.006, 0.008)
    }
    assert pairs("setting2_wide", "algorithm", "shape", "shift") == {
        (method, "2", 0.008) for method in methods
    }
    assert pairs("ablation", "algorithm", "shape") == {
        (method, shape) for method in ("crsfd", *arms) for shape in "1234"
    }
    places = ("2", 0.0, 5), ("2", 0.004, 5)
    assert pairs("sensitivity", "shape", "shift", "seeds") == set(places)
    assert pairs("sensitivity", "demo_episodes") == {(0,), (1,), (5,), (10,)}
    parts = {cell.config.scene.clearance for cell in experiment("sensitivity").cells}
    assert parts == {1e-3, 2e-3, 5e-4, 3e-4}
    kinds = {f"runs/demos/{name}.npz" for name in ("noise1", "noise3", "expert1")}
    assert pairs("sensitivity", "shift", "algorithm", "demos") == {
        (shift, method, demos)
        for shift in (0.0, 0.004)
        for method in ("crsfd", "sacfd")
        for demos in ("builtin", *kinds)
    }
    assert pairs("next_task", "algorithm", "shape", "shift", "demos") == {
        (method, "2", 0.008, "runs/demos/search.npz") for method in ("crsfd", "sacfd", "bc")
    }
    assert pairs("reward_scale", "algorithm", "shape", "shift") == {
        (method, "2", 0.0) for method in ("crsfd", "sacfd")
    }
    errors = [cell.config.randomisation for cell in experiment("transfer").cells]
    assert errors.count(TRAINING) == 10 and len(errors) == 15


def test_the_most_telling_cells_come_first():
    order = [cell.config.algorithm for cell in experiment("setting1").cells]
    assert list(dict.fromkeys(order))[:5] == ["crsfd", "sacfd", "sac", "bc", "rlpd"]


def test_a_name_says_every_option_but_how_far_a_run_goes():
    plain = Config(shape="3", shift=0.008)
    assert run_name(plain) == "crsfd-shape3-shift8mm-seed0x5"
    further = Config(shape="3", shift=0.008, steps=10**6, evaluation=Evaluation(every=64))
    assert run_name(further) == run_name(plain)
    other = Config(demo_episodes=5, demos="a/b.npz")
    assert run_name(other) == "crsfd-shape2-shift0mm-seed0x5-demosa_b.npz-demo_episodes5"


@pytest.mark.parametrize(
    ("text", "answer"),
    {
        "CELLS = (('--shape', '9'),)": "cell 0: --shape: got '9'",
        "CELLS = (('--shape', '1'), ('--shape=1', '--steps', '90000'))": (
            "more than once (--steps and"
        ),
        "CELLS = (('--out', 'x'),)": "--out: got 'x', allowed: none",
        "CELLS = ()": "defines no CELLS",
        "CELLS = 5": "CELLS: got 5, expected a tuple of argument tuples",
        "CELLS = ('--shape',)": "CELLS: got ('--shape',), expected",
        "CELLS = ((),)\nTRIALS = '--held-out'": "TRIALS: got '--held-out', expected a tuple",
        "CELLS = ((),)\nTRIALS = ('--episodes', '0')": "--episodes: got 0",
        "CELLS = ((),)\nDEMOS = ('a',)": "DEMOS: got ('a',), expected files",
        "CELLS = 1 / 0": "ZeroDivisionError",
        "CELLS =": "SyntaxError",
    }.items(),
)
def test_a_wrong_experiment_is_answered_with_one_line(tmp_path, text, answer):
    path = tmp_path / "wrong.py"
    path.write_text(text)
    with pytest.raises(UserError) as error:
        cells.load(str(path))
    assert answer in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("early --gpus 1", "--gpus: got 1 with --runner local"),
        ("early --status --dry-run", "--status: got --dry-run as well"),
        ("early --gpus 0.5 --runner slurm", "--gpus: got 0.5, allowed with slurm: whole ones"),
        ("early --slurm.minutes 9", "--slurm: got options of it with --runner local"),
        (f"early --status --out {__file__}", "--out: got .* a file, allowed: a folder"),
        ("early --out /proc/absent/x", "--out: got '/proc/absent/x', which cannot be written"),
        ("absent.py", "--experiment: got 'absent.py', which does not exist"),
    ],
)
def test_options_that_would_do_nothing_are_refused(line, answer):
    with pytest.raises(UserError, match=answer):
        sweep.run(["--experiment", *line.split()])


def test_an_unknown_experiment_ends_with_one_line_and_exit_code_2():
    command = [sys.executable, "-m", "crsfd_jax.sweep", "--experiment", "setting3"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1 and "did you mean setting" in done.stderr


def test_the_first_episodes_of_a_file_are_used():
    whole, first = builtin.load("builtin"), builtin.load("builtin", 5)
    steps = whole.episode_length[:5].sum()
    assert len(first.obs) == len(first.reward) == steps and first.terminated[-1]
    np.testing.assert_array_equal(first.obs, whole.obs[:steps])
    assert first.socket_offset.shape == (5, 2)
    with pytest.raises(UserError, match="--demo-episodes: got 41, allowed: at most the 40"):
        builtin.load("builtin", 41)


def test_every_cell_is_run_once_and_finished_ones_are_skipped(file, out, capsys):
    assert swept(file, "--workers", "2") == 0
    for name in NAMES:
        assert_whole(out, name)
        assert len(starts(out, name)) == 1
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    assert swept(file) == 0
    assert "3 done, 0 failed" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == before


def test_more_steps_or_a_lost_file_make_a_finished_cell_unfinished(file, out):
    assert swept(file, "--only", NAMES[0]) == 0
    cell = cells.load(str(file)).cells[0]
    folder = out / cell.name
    assert state.is_finished(folder, cell.config)
    assert not state.is_finished(folder, replace(cell.config, seed=1))
    assert not state.is_finished(folder, replace(cell.config, steps=5000))
    (folder / "policy.npz").rename(folder / "away")
    assert not state.is_finished(folder, cell.config)
    (folder / "away").rename(folder / "policy.npz")
    metrics.truncate(folder / "metrics.csv", STEPS[-2])
    assert not state.is_finished(folder, cell.config)


def test_options_for_every_cell_are_part_of_its_name(file, out, capsys):
    also = "--", "--sac.gamma", "0.97", "--steps", "2048"
    assert swept(file, "--only", f"{NAMES[0]}*", *also) == 0
    name = f"{NAMES[0]}-sac.gamma0.97"
    assert artefacts.read_config(out / name).sac.gamma == 0.97
    assert metrics.read(out / name / "metrics.csv")["env_steps"].max() == 2048
    with pytest.raises(UserError, match=r"cell 0: --sac\.gamma: got 2"):
        swept(file, "--", "--sac.gamma", "2")


def test_a_folder_with_a_run_of_other_options_is_told(file, out, capsys):
    assert swept(file, "--only", NAMES[0]) == 0
    described = out / NAMES[0] / "config.json"
    changed = described.read_text().replace('"every": 2048', '"every": 1024')
    described.write_text(changed)
    assert '"every": 1024' in changed and swept(file, "--status") == 0
    assert "1 other, 2 new" in capsys.readouterr().out.splitlines()[-1]


def test_a_dry_run_and_a_status_write_nothing(file, out, capsys):
    assert swept(file, "--dry-run") == 0
    printed = capsys.readouterr().out
    assert "Three shapes." in printed and "3 new" in printed
    assert f"--smoke --shape 1 --out {out / NAMES[0]}" in printed
    assert not out.exists()
    assert swept(file, "--only", NAMES[1]) == 0
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    capsys.readouterr()
    assert swept(file, "--status") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[4].split() == [NAMES[1], "done", "4,096/4,096", "0.250", "0.7"]
    assert lines[-1] == "2 new, 1 done"
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == before


def test_a_killed_run_is_tried_again_and_resumes(file, out, monkeypatch):
    monkeypatch.setenv("FAKE_FAIL", f"{NAMES[1]} once")
    assert swept(file, "--only", NAMES[1]) == 0
    assert len(starts(out, NAMES[1])) == 2
    assert_whole(out, NAMES[1])
    assert "attempt 2 of 2" in (out / f"{NAMES[1]}.log").read_text()


def test_cells_that_fail_are_listed_with_the_end_of_their_logs(file, out, monkeypatch, capsys):
    monkeypatch.setenv("FAKE_FAIL", f"{NAMES[0]} crash, {NAMES[1]} usage")
    assert swept(file, "--workers", "3") == 1
    printed = capsys.readouterr().out
    assert "1 done, 2 failed, 0 to be continued" in printed
    for name, attempts, reason in (
        (NAMES[0], 2, "RuntimeError: something broke"),
        (NAMES[1], 1, "--this: cannot be used"),
    ):
        assert f"failed  {out / name}.log" in printed and reason in printed
        assert len(starts(out, name)) == attempts
    swept(file, "--status")
    assert f"{NAMES[0]}  failed" in capsys.readouterr().out


def test_a_log_that_cannot_be_opened_fails_its_cell_and_no_other(file, out, capsys):
    out.mkdir(parents=True)
    (out / f"{NAMES[0]}.log").symlink_to(out / "absent" / "log")
    assert swept(file) == 1
    printed = capsys.readouterr().out
    assert "2 done, 1 failed" in printed and "No such file or directory" in printed


def test_words_of_demonstrations_may_be_numbers_and_paths(tmp_path):
    path = tmp_path / "noisy.py"
    path.write_text(
        "from pathlib import Path\n"
        "CELLS = (('--demos', 'a.npz'),)\n"
        "DEMOS = {Path('a.npz'): ('record', '--noise', 3)}\n"
    )
    assert cells.load(str(path)).demos == {"a.npz": ("record", "--noise", "3")}


def test_refused_demonstrations_are_not_taken_the_next_time(tmp_path, monkeypatch):
    """The command writes its file and says that the expert learned too little."""
    monkeypatch.chdir(tmp_path)
    writes = "import sys; open(sys.argv[-1], 'w').write('x'); sys.exit(1)"
    monkeypatch.setattr(demonstrations, "DEMOS", (sys.executable, "-c", writes))
    cell = cells.Cell("a", (), Config(demos="a.npz"))
    wanted = cells.Experiment("e", "", (cell,), {"a.npz": ("record",)})
    for _ in range(2):
        with pytest.raises(UserError, match=r"kept as refused-a\.npz") as error:
            demonstrations.make(wanted, [cell])
        assert error.value.exit_code == 1 and not Path("a.npz").exists()


def test_refused_demonstrations_are_put_aside_before_another_sweep_looks(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    writes = "import sys; open(sys.argv[-1], 'w').write('x'); sys.exit(1)"
    monkeypatch.setattr(demonstrations, "DEMOS", (sys.executable, "-c", writes))
    cell = cells.Cell("a", (), Config(demos="a.npz"))
    rename, held = Path.rename, []

    def noted(path, target):
        held.append(state.is_held(Path(".a.npz.lock")))
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", noted)
    with pytest.raises(UserError):
        demonstrations.make(cells.Experiment("e", "", (cell,), {"a.npz": ("record",)}), [cell])
    assert held == [True]


def test_a_recording_that_outlives_its_sweep_keeps_its_lock(tmp_path):
    program = """if True:
        from crsfd_jax.config import Config
        from crsfd_jax.sweeps import cells, demonstrations
        demonstrations.DEMOS = "sh", "-c", "echo $$ > recorder; exec sleep 60"
        cell = cells.Cell("a", (), Config(demos="a.npz"))
        demonstrations.make(cells.Experiment("e", "", (cell,), {"a.npz": ("x",)}), [cell])
    """
    process = subprocess.Popen([sys.executable, "-c", program], cwd=tmp_path, env=at_root())
    wait_for(lambda: (tmp_path / "recorder").is_file() and (tmp_path / "recorder").read_text())
    process.kill()
    process.wait(timeout=60)
    assert state.is_held(tmp_path / ".a.npz.lock")
    os.kill(int((tmp_path / "recorder").read_text()), signal.SIGKILL)
    wait_for(lambda: not state.is_held(tmp_path / ".a.npz.lock"))


def test_a_run_that_stops_by_itself_is_not_tried_again(file, out, monkeypatch):
    monkeypatch.setenv("FAKE_FAIL", f"{NAMES[0]} stop")
    assert swept(file, "--only", NAMES[0]) == 75
    assert len(starts(out, NAMES[0])) == 1


def test_a_signal_lets_runs_save_and_the_same_command_goes_on(file, out, monkeypatch):
    monkeypatch.setenv("FAKE_STEP_S", "1")
    process = started(file, "--workers", "2")
    wait_for(lambda: (out / NAMES[0] / "metrics.csv").is_file())
    process.send_signal(signal.SIGTERM)
    printed, _ = process.communicate(timeout=60)
    assert process.returncode == 75 and "0 done, 0 failed, 3 to be continued" in printed
    assert metrics.read(out / NAMES[0] / "metrics.csv")["env_steps"].max() < STEPS[-1]
    assert not state.is_held(out / f"{NAMES[0]}.log")
    assert not (out / NAMES[2]).exists()
    monkeypatch.setenv("FAKE_STEP_S", "0")
    assert swept(file, "--workers", "3") == 0
    for name in NAMES:
        assert_whole(out, name)


def test_two_sweeps_at_once_run_every_cell_once(file, out, monkeypatch):
    monkeypatch.setenv("FAKE_STEP_S", "0.1")
    both = [started(file, "--workers", "2") for _ in range(2)]
    for process in both:
        printed, _ = process.communicate(timeout=60)
        assert process.returncode == 0 and "3 done, 0 failed" in printed, printed
    for name in NAMES:
        assert (out / f"{name}.log").read_text().count("sweep: attempt") == 1
        assert_whole(out, name)


def test_the_orphan_of_a_killed_sweep_is_waited_for(file, out, monkeypatch):
    monkeypatch.setenv("FAKE_STEP_S", "1")
    process = started(file)
    wait_for(lambda: (out / NAMES[0] / "metrics.csv").is_file())
    process.kill()
    process.communicate(timeout=60)
    monkeypatch.setenv("FAKE_STEP_S", "0")
    assert swept(file, "--only", "*shape[12]*") == 0
    assert [len(starts(out, name)) for name in NAMES] == [1, 1, 0]
    assert (out / f"{NAMES[0]}.log").read_text().count("sweep: attempt") == 1


def test_a_run_started_by_hand_is_left_alone(file, out, monkeypatch):
    monkeypatch.setenv("FAKE_STEP_S", "1")
    cell = cells.load(str(file)).cells[0]
    process = subprocess.Popen([*FAKE, *cell.arguments, "--out", str(out / cell.name)])
    wait_for(lambda: (out / cell.name / "metrics.csv").is_file())
    assert state.read(out, cell).word == "running"
    assert [end.word for end in attempt.run_group((cell,), Plan(out, FAKE))] == ["busy"]
    assert process.wait(timeout=60) == 0
    assert starts(out, cell.name) == [process.pid]


def test_alike_cells_share_a_process(file, out, capsys):
    assert swept(file, "--together", "2", "--dry-run") == 0
    printed = capsys.readouterr().out
    assert f"--shape 1 --out {out / NAMES[0]} --and --smoke --shape 2 --out" in printed
    assert printed.count("fake_train.py") == 2
    assert swept(file, "--together", "2") == 0
    owners = [starts(out, name) for name in NAMES]
    assert owners[0] == owners[1] != owners[2] and list(map(len, owners)) == [1, 1, 1]
    for name in NAMES:
        assert_whole(out, name)
    assert f"sweep: together with {NAMES[0]}" in (out / f"{NAMES[1]}.log").read_text()


def test_cells_that_differ_in_more_than_their_task_or_stand_elsewhere_are_apart(file, out):
    first, second, third = cells.load(str(file)).cells
    other = third._replace(config=replace(third.config, algorithm="sac"))
    assert sweep.grouped([first, other, second], out, 3) == [(first, second), (other,)]
    assert sweep.grouped([first, other, second], out, 1) == [(first,), (other,), (second,)]
    (out / second.name / "checkpoints" / "16").mkdir(parents=True)
    assert sweep.grouped([first, second, third], out, 3) == [(first, third), (second,)]


def test_a_wrong_cell_does_not_take_those_beside_it_down(file, out, monkeypatch, capsys):
    monkeypatch.setenv("FAKE_FAIL", f"{NAMES[1]} usage")
    assert swept(file, "--together", "3") == 1
    assert "2 done, 1 failed" in capsys.readouterr().out
    assert_whole(out, NAMES[0])
    assert_whole(out, NAMES[2])


def test_a_cell_that_crashes_does_not_fail_those_beside_it(file, out, monkeypatch, capsys):
    monkeypatch.setenv("FAKE_FAIL", f"{NAMES[0]} crash")
    assert swept(file, "--together", "3") == 1
    assert "2 done, 1 failed" in capsys.readouterr().out


def test_a_group_that_stops_by_itself_goes_on_as_single_cells(file, out, monkeypatch, capsys):
    monkeypatch.setenv("FAKE_FAIL", f"{NAMES[1]} crowded")
    assert swept(file, "--together", "3") == 0
    assert [len(starts(out, name)) for name in NAMES] == [1, 2, 1]
    for name in NAMES:
        assert_whole(out, name)


def test_a_log_that_cannot_be_opened_leaves_its_group_alone(file, out, capsys):
    out.mkdir(parents=True)
    (out / f"{NAMES[1]}.log").symlink_to(out / "absent" / "log")
    assert swept(file, "--together", "3") == 1
    assert "2 done, 1 failed" in capsys.readouterr().out


def test_cells_that_lack_their_trials_alone_are_not_trained_again(file, out):
    assert swept(file) == 0
    chosen = [cell._replace(trials=("--episodes", "5")) for cell in cells.load(str(file)).cells]
    attempt.run_group(tuple(chosen), Plan(out, FAKE, retries=0))
    assert [len(starts(out, name)) for name in NAMES] == [1, 1, 1]
    assert "together" not in (out / f"{NAMES[0]}.log").read_text()


def test_a_signal_after_the_last_cell_changes_nothing(tmp_path):
    chosen = cells.load("joint").cells[:2]
    ended = {cell.name: attempt.CellResult(cell.name, "done") for cell in chosen}
    assert sweep._summarise(chosen, Plan(tmp_path), ended, True) == 0
    ended.pop(chosen[0].name)
    assert sweep._summarise(chosen, Plan(tmp_path), ended, True) == STOPPED


def test_a_run_started_by_hand_leaves_those_beside_it_to_the_sweep(file, out, monkeypatch):
    """Started in the moment between the look at its lock and the start of the group."""
    monkeypatch.setenv("FAKE_STEP_S", "60")
    chosen = cells.load(str(file)).cells
    process = subprocess.Popen([*FAKE, *chosen[1].arguments, "--out", str(out / NAMES[1])])
    wait_for(lambda: starts(out, NAMES[1]))
    monkeypatch.setenv("FAKE_STEP_S", "0")
    looks = iter([False] * 3)
    is_held = state.is_held
    monkeypatch.setattr(state, "is_held", lambda path: next(looks, is_held(path)))
    ended = {end.name: end.word for end in attempt.run_group(chosen, Plan(out, FAKE))}
    assert ended == dict(zip(NAMES, ("done", "busy", "done"), strict=True))
    process.kill()
    process.wait(timeout=60)


@pytest.mark.parametrize(
    ("workers", "shares"),
    [(2, [[0, 2], [1, 3]]), (3, [[0, 3], [1], [2]]), (5, [[0], [1], [2], [3], [0]])],
)
def test_workers_share_the_cores(monkeypatch, workers, shares):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3})
    assert local_pool._core_shares(workers) == shares


def test_the_log_of_a_cell_that_is_busy_is_let_go(file, out, monkeypatch):
    monkeypatch.setenv("FAKE_STEP_S", "1")
    chosen = cells.load(str(file)).cells[:2]
    process = subprocess.Popen([*FAKE, *chosen[0].arguments, "--out", str(out / NAMES[0])])
    wait_for(lambda: (out / NAMES[0] / "metrics.csv").is_file())
    held = []

    def stopping():
        held.append(state.is_held(out / f"{NAMES[0]}.log"))
        return True

    ended = attempt.run_group(chosen, Plan(out, FAKE), stopping)
    assert [end.word for end in ended] == ["busy", "stopped"] and not any(held) and held
    process.terminate()
    process.wait(timeout=60)


def test_the_orphan_of_a_killed_sweep_keeps_every_log_of_its_group(file, out, monkeypatch):
    monkeypatch.setenv("FAKE_STEP_S", "1")
    process = started(file, "--together", "3")
    wait_for(lambda: (out / NAMES[0] / "metrics.csv").is_file())
    process.kill()
    process.communicate(timeout=60)
    assert all(state.is_held(out / f"{name}.log") for name in NAMES)
    monkeypatch.setenv("FAKE_STEP_S", "0")
    assert swept(file) == 0
    assert [len(starts(out, name)) for name in NAMES] == [1, 1, 1]


def test_a_killed_group_is_tried_again(file, out, monkeypatch):
    monkeypatch.setenv("FAKE_FAIL", f"{NAMES[1]} once")
    assert swept(file, "--together", "3") == 0
    assert [len(starts(out, name)) for name in NAMES] == [1, 2, 1]
    for name in NAMES:
        assert_whole(out, name)


def test_ray_runs_and_retries_cells(file, out, monkeypatch):
    pytest.importorskip("ray")
    monkeypatch.setenv("FAKE_FAIL", f"{NAMES[1]} once")
    assert swept(file, "--runner", "ray", "--workers", "2") == 0
    assert [len(starts(out, name)) for name in NAMES] == [1, 2, 1]


def test_what_a_killed_ray_worker_left_running_is_waited_for(file, out, monkeypatch):
    """Its task is started anew, and finds the cell running."""
    pytest.importorskip("ray")
    monkeypatch.setenv("FAKE_STEP_S", "2")
    process = started(file, "--runner", "ray", "--only", NAMES[0])
    wait_for(lambda: (out / NAMES[0] / "metrics.csv").is_file())
    [orphan] = starts(out, NAMES[0])
    worker = parent(orphan)
    assert worker != process.pid
    os.kill(worker, signal.SIGKILL)
    printed, _ = process.communicate(timeout=120)
    assert process.returncode == 0 and "1 done, 0 failed" in printed, printed
    assert starts(out, NAMES[0]) == [orphan]
    assert_whole(out, NAMES[0])


def test_slurm_jobs_run_cells(file, out):
    pytest.importorskip("submitit")
    chosen = cells.load(str(file)).cells[:2]
    asked = slurm_array.Slurm(minutes=5, cores=1)
    ended = list(
        slurm_array.run(
            [chosen],
            Plan(out, FAKE),
            2,
            0.0,
            asked,
            lambda: False,
            cluster="local",
        )
    )
    assert sorted((outcome.name, outcome.word) for outcome in ended) == [
        (name, "done") for name in NAMES[:2]
    ]
    for name in NAMES[:2]:
        assert_whole(out, name)


def test_a_slurm_job_whose_time_is_up_saves_and_is_queued_again(file, out, monkeypatch):
    pytest.importorskip("submitit")
    monkeypatch.setenv("FAKE_STEP_S", "1")
    chosen, ended = cells.load(str(file)).cells[:1], []

    def wait():
        plan, asked = Plan(out, FAKE), slurm_array.Slurm(minutes=5, cores=1)
        ended.extend(slurm_array.run([chosen], plan, 1, 0.0, asked, lambda: False, cluster="local"))

    waiting = threading.Thread(target=wait)
    waiting.start()
    wait_for(lambda: (out / NAMES[0] / "metrics.csv").is_file())
    [trainer] = starts(out, NAMES[0])
    os.kill(parent(trainer), signal.SIGUSR2)
    waiting.join(timeout=120)
    assert [outcome.word for outcome in ended] == ["done"]
    assert len(starts(out, NAMES[0])) == 2
    assert_whole(out, NAMES[0])


@pytest.mark.parametrize(("runner", "extra"), [("ray", "ray"), ("slurm", "submitit")])
def test_a_missing_runner_is_named_with_its_extra(file, monkeypatch, runner, extra):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(UserError, match=f"needs {extra}.*pip install -e"):
        swept(file, "--runner", runner)


@pytest.mark.slow
def test_a_sweep_trains_cells_together(file, out):
    (file.parent / "one.py").write_text(
        "SMALL = '--smoke', '--steps', '2048', '--potential.steps', '50'\n"
        "CELLS = (*SMALL, '--shape', '1'), (*SMALL, '--shape', '3', '--shift', '8mm')"
    )
    command = [sys.executable, "-m", "crsfd_jax.sweep", "--experiment", "one.py", "--together", "2"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    for cell in cells.load("one.py").cells:
        assert state.read(out.parent / "one", cell).word == "done"
