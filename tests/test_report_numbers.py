"""The document of all numbers: which two cells are set beside each other, and what is said."""

import numpy as np
import pytest
from report_runs import STEPS, cells_of, make_run, played, rising, transfer_run

from crsfd_jax.config import Potential, Replay
from crsfd_jax.report import differences, markdown, numbers, page, tables

WITHOUT_ROWS = {"replay": Replay(draw_demos="no")}
COLD = {"potential": Potential(gamma=0.9)}


def meetings(folder):
    """Title -> [first, second] of every row but those of means."""
    found = differences.find(cells_of(folder))
    rows = {title: [row[:3] for row in table.rows] for title, table in found}
    return {title: [row for row in each if "these" not in row[0]] for title, each in rows.items()}


def test_methods_meet_with_the_same_options_and_options_within_a_method(tmp_path):
    for name, method, other in (
        ("a", "crsfd", {}),
        ("b", "sacfd", {}),
        ("c", "sacfd", WITHOUT_ROWS),
        ("d", "crsfd", WITHOUT_ROWS),
        ("e", "sqil", {}),
    ):
        make_run(tmp_path / name, method, **other)
    alone = "no demonstrations in batches"
    assert meetings(tmp_path)["No shift, 1k steps"] == [
        ("2", "CRSfD", "SACfD"),
        ("2", "CRSfD", "SQIL"),
        ("2", f"CRSfD, {alone}", "CRSfD"),
        ("2", f"CRSfD, {alone}", f"SACfD, {alone}"),
        ("2", f"SACfD, {alone}", "SACfD"),
    ]


def test_a_variant_that_the_other_method_lacks_meets_its_usual_runs(tmp_path):
    make_run(tmp_path / "a", "crsfd")
    make_run(tmp_path / "b", "sacfd")
    make_run(tmp_path / "c", "crsfd", **COLD)
    make_run(tmp_path / "d", "sacfd", **WITHOUT_ROWS)
    found = meetings(tmp_path)["No shift, 1k steps"]
    assert ("2", "CRSfD, gamma_0 0.9", "SACfD") in found
    assert ("2", "CRSfD", "SACfD, no demonstrations in batches") in found


def test_other_steps_and_unfinished_runs_do_not_meet(tmp_path):
    make_run(tmp_path / "a", "crsfd")
    make_run(tmp_path / "b", "sacfd", values=rising(0)[:5], steps=500)
    make_run(tmp_path / "c", "sqil", values=rising(0)[:5], steps=1000)
    assert meetings(tmp_path) == {}


def test_a_method_that_does_not_interact_meets_runs_of_any_length(tmp_path):
    make_run(tmp_path / "a", "crsfd", shift=8.0)
    make_run(tmp_path / "b", "bc", shift=8.0, values=rising(0)[:5], steps=500)
    (row,) = differences.find(cells_of(tmp_path))[0][1].rows
    assert row[:3] == ("2", "CRSfD", "BC")
    assert row[5] == "1.000, no steps" and row[6:8] == ("-", "-")
    by_method = {row[1]: row for row in tables.results(cells_of(tmp_path)).rows}
    assert by_method["CRSfD"][3] == "1,000" and float(by_method["CRSfD"][8]) > 0
    level = by_method["BC"]
    assert (level[3], level[6], level[8]) == ("no interaction", "", "")


def test_a_row_says_what_is_worked_out_by_hand(tmp_path):
    ours, theirs = rising(0), rising(200, top=0.8)
    make_run(tmp_path / "a", "crsfd", values=ours)
    make_run(tmp_path / "b", "sacfd", values=theirs)
    (row,) = differences.find(cells_of(tmp_path))[0][1].rows
    steps = np.append(0, STEPS)
    areas = [
        np.trapezoid(np.vstack([np.zeros(5), v]), steps, axis=0) / 1000 for v in (ours, theirs)
    ]
    gap = areas[0] - areas[1]
    half = 2.7764451 * gap.std(ddof=1) / np.sqrt(5)
    assert row[3] == "5"
    assert row[4] == f"1.000, 0k, {areas[0].mean():.3f}"
    assert row[5] == f"0.800, not reached, {areas[1].mean():.3f}"
    mean = gap.mean()
    assert row[6] == f"{mean:+.3f} [{mean - half:+.3f}, {mean + half:+.3f}]"
    assert row[8] == "+0.200 [+0.200, +0.200]"


def test_the_mean_over_shapes_is_of_single_shapes_and_weighs_them_alike(tmp_path):
    for shape, top in (("1", 0.5), ("2", 0.7), ("all", 0.1)):
        make_run(tmp_path / f"{shape}a", "crsfd", shape, values=rising(0))
        make_run(tmp_path / f"{shape}b", "sacfd", shape, values=rising(0, top))
    rows = differences.find(cells_of(tmp_path))[0][1].rows
    assert [row[0] for row in rows] == ["1", "2", "these 2", "all"]
    assert [float(row[8].split()[0]) for row in rows] == pytest.approx([0.5, 0.3, 0.4, 0.9])


def test_the_document_holds_cells_differences_and_trials(tmp_path):
    make_run(tmp_path / "a", "crsfd")
    make_run(tmp_path / "b", "sacfd")
    for shape in "12":
        run = transfer_run(tmp_path / f"t{shape}", shape, successes=80)
        played(run, (0, shape, 100, 70), options="--episodes 100", name="own.csv")
    report = page.collect([str(tmp_path)])
    text = numbers.document(report.cells, report.trials)
    titles = [line for line in text.splitlines() if line.startswith("#")]
    assert titles == [
        "# Numbers",
        "## Each method on each task",
        "## Differences: No shift, 1k steps",
        "## Trials held out from training",
        "## Trials on the task of training",
    ]
    held = [line for line in text.splitlines() if line.startswith("| CRSfD, 2 mm, randomised |")]
    assert [line.split("|")[2].strip() for line in held] == ["1", "2", "all"]
    assert "800 of 1000" in held[-1]


def test_a_bar_in_a_cell_ends_no_column():
    assert markdown.table(("a",), [("x|y",)]) == "| a |\n| --- |\n| x\\|y |"
