"""Results that are kept: tables of runs, as a report reads them, without this machine's paths."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import script
from report_runs import make_run, transfer_run

from crsfd_jax.errors import UserError
from crsfd_jax.report import cells as grouping
from crsfd_jax.report import runs, trials


@pytest.fixture
def collect(tmp_path, monkeypatch):
    made = script.load(Path(__file__).parents[1] / "experiments" / "collect.py")
    monkeypatch.setattr(made, "RESULTS", tmp_path / "results")
    return made


def shown(folder):
    """Curves and trials of the runs in a folder."""
    cells, _ = grouping.gather(runs.find([folder]).runs)
    played, skipped = trials.find([folder], cells)
    assert not skipped
    return cells, [(t.cell.method, t.shape, t.successes.tolist()) for t in played]


def test_what_is_collected_is_reported_as_the_runs_are(collect, tmp_path):
    transfer_run(tmp_path / "runs" / "moved" / "a")
    make_run(
        tmp_path / "runs" / "still" / "b", "sacfd", demos="/home/me/mine.npz", out="/home/me/b"
    )
    collect.main([str(tmp_path / "runs")])
    results = tmp_path / "results"
    assert sorted(str(path.relative_to(results)) for path in results.rglob("*.*")) == [
        *("moved/a-trials.csv", "moved/a.csv", "moved/a.json"),
        *("still/b.csv", "still/b.json"),
    ]
    (cells, played), (kept, kept_trials) = shown(tmp_path / "runs"), shown(results)
    assert played == kept_trials
    for one, other in zip(cells, kept, strict=True):
        assert one.task == other.task and one.method == other.method
        np.testing.assert_array_equal(one.curve.values, other.curve.values)
    assert "/home/me" not in (results / "still" / "b.json").read_text()


def test_a_run_without_an_evaluation_does_not_keep_the_others_from_it(collect, tmp_path, capsys):
    for name in "ab":
        make_run(tmp_path / "runs" / name)
    (tmp_path / "runs" / "a" / "metrics.csv").unlink()
    collect.main([str(tmp_path / "runs")])
    assert [path.name for path in sorted((tmp_path / "results").rglob("*.*"))] == [
        "b.csv",
        "b.json",
    ]
    assert "left out" in capsys.readouterr().out
    shutil.rmtree(tmp_path / "runs")
    (tmp_path / "runs").mkdir()
    with pytest.raises(UserError, match="no run in it"):
        collect.main([str(tmp_path / "runs")])
