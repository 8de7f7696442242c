"""What an experiment asks for beside its runs: demonstrations before them, trials after them."""

import os
import sys
from pathlib import Path

import pytest

from crsfd_jax import sweep
from crsfd_jax.errors import UserError
from crsfd_jax.storage import metrics
from crsfd_jax.sweeps import attempt, cells, demonstrations

ROOT = Path(__file__).parents[1]
FAKE_TRAIN = (sys.executable, str(Path(__file__).parent / "fake_train.py"))
NAME = "crsfd-shape1-shift0mm-seed0x2-smoke"
NOTE = "import sys; from pathlib import Path; out = Path(sys.argv[-1]); "
"""A program whose last argument is the file that it writes."""
WRITE = NOTE + "out.write_text(' '.join(sys.argv[1:]))"
PLAY = NOTE + (
    "assert not out.exists(); words = ' '.join(sys.argv[2:-2]); "
    "out.write_text('seed,shape,trials,successes,options\\n0,1,7,3,' + words + '\\n')"
)
TWICE = NOTE + "tried = out.with_name('tried'); first = not tried.exists(); tried.touch(); "


def fake(program: str) -> tuple[str, ...]:
    return (sys.executable, "-c", program)


@pytest.fixture
def file(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("PYTHONPATH", str(ROOT), prepend=os.pathsep)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(attempt, "EVALUATE", fake(PLAY))
    monkeypatch.setattr(demonstrations, "DEMOS", fake(WRITE))
    path = tmp_path / "beside.py"
    path.write_text(
        'DEMOS = {"demos/a.npz": ("record", "--noise", "1"), "demos/unused.npz": ("record",)}\n'
        'TRIALS = ("--held-out", "--episodes", "7")\n'
        'CELLS = ("--smoke", "--shape", "1"), ("--smoke", "--demos", "demos/a.npz")\n'
    )
    return path


def swept(file: Path, *options: str) -> int:
    return sweep.run(["--experiment", str(file), *options], command=FAKE_TRAIN)


def test_each_cell_has_its_trials_once_it_is_trained(file):
    assert swept(file) == 0
    for cell in cells.load(str(file)).cells:
        folder = Path.cwd() / "runs" / "beside" / cell.name
        table = folder / "trials.csv"
        assert table.read_text().splitlines()[1] == "0,1,7,3,--held-out --episodes 7"
        written = table.stat().st_mtime_ns
        assert swept(file) == 0
        assert table.stat().st_mtime_ns == written
        assert len((folder / "starts").read_text().split()) == 1


def test_a_cell_without_its_trials_is_not_done(file, capsys):
    swept(file, "--only", NAME)
    (Path("runs/beside") / NAME / "trials.csv").unlink()
    capsys.readouterr()
    swept(file, "--status", "--only", NAME)
    assert "1 stopped" in capsys.readouterr().out
    assert swept(file, "--only", NAME) == 0
    assert (Path("runs/beside") / NAME / "trials.csv").exists()


def test_a_run_that_goes_on_has_its_trials_again(file):
    swept(file, "--only", NAME)
    run = Path("runs/beside") / NAME
    (run / "trials.csv").write_text("old")
    metrics.truncate(run / "metrics.csv", 1024)
    assert swept(file, "--only", NAME) == 0
    assert "--held-out" in (run / "trials.csv").read_text()


def test_other_trials_than_were_played_are_played(file, capsys):
    swept(file, "--only", NAME)
    run = Path("runs/beside") / NAME
    starts = (run / "starts").read_text()
    file.write_text(file.read_text().replace('"7"', '"9"'))
    capsys.readouterr()
    swept(file, "--dry-run", "--only", NAME)
    said = capsys.readouterr().out
    assert "--episodes 9 --csv" in said and "fake_train" not in said and "1 stopped" in said
    assert swept(file, "--only", NAME) == 0
    assert (run / "trials.csv").read_text().endswith("--held-out --episodes 9\n")
    assert (run / "starts").read_text() == starts, "it was not trained again"


def test_trials_that_fail_are_tried_again_and_then_listed(file, monkeypatch, capsys):
    monkeypatch.setattr(attempt, "EVALUATE", fake(TWICE + "first and sys.exit(1); out.touch()"))
    assert swept(file, "--only", NAME) == 0
    (Path("runs/beside") / NAME / "trials.csv").unlink()
    monkeypatch.setattr(attempt, "EVALUATE", fake("raise SystemExit('no arm')"))
    assert swept(file, "--only", NAME) == 1
    assert "no arm" in capsys.readouterr().out


def test_demonstrations_that_are_read_are_made_once(file):
    assert swept(file, "--only", NAME) == 0
    assert not Path("demos").exists()
    assert swept(file) == 0
    made = Path("demos/a.npz")
    assert made.read_text() == "record --noise 1 --out demos/a.npz"
    assert not Path("demos/unused.npz").exists()
    written = made.stat().st_mtime_ns
    assert swept(file) == 0
    assert made.stat().st_mtime_ns == written


def test_demonstrations_that_cannot_be_made_stop_the_sweep(file, monkeypatch):
    monkeypatch.setattr(demonstrations, "DEMOS", fake("raise SystemExit(2)"))
    with pytest.raises(UserError, match=r"demos/a\.npz: could not be made") as raised:
        swept(file)
    assert raised.value.exit_code == 2
    assert not list(Path("runs").rglob("*.*"))


def test_a_dry_run_tells_of_both_and_makes_neither(file, capsys):
    assert swept(file, "--dry-run") == 0
    printed = capsys.readouterr().out
    assert "record --noise 1 --out demos/a.npz" in printed
    assert printed.count("--held-out --episodes 7 --csv") == 2
    assert not Path("demos").exists() and not Path("runs").exists()
