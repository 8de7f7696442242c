"""Trials of trained policies in a report: whose they are, under what, and how sure they make."""

import shutil

import pytest
from report_runs import cells_of, make_run, played, rising, transfer_run

from crsfd_jax import intervals
from crsfd_jax.errors import UserError
from crsfd_jax.options.randomisation import TRAINING, Randomisation
from crsfd_jax.report import evidence, tables, transfer, trial_sections, trials
from crsfd_jax.report.cells import Task
from crsfd_jax.report.evidence import HOLDS, OPEN
from crsfd_jax.storage import trials as table


def found_in(*folders):
    return trials.find(folders, cells_of(*folders))


def told(found):
    return [(t.label, t.shape, int(t.successes.sum()), int(t.trials.sum())) for t in found]


def test_a_table_is_read_as_it_was_written(tmp_path):
    rows = [table.Row(0, "2", 9, 7, "--held-out"), table.Row(1, "my-shape", 9, 0, "")]
    table.write(tmp_path / "t.csv", rows, "--csv")
    assert table.read(tmp_path / "t.csv") == rows
    (tmp_path / "other.csv").write_text("fruit,price\napple,1\n")
    assert table.read(tmp_path / "other.csv") == []


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("seed,shape,trials,successes,options\n0,2,5,6,\n", "seed 0 has 6 of 5 trials"),
        ("seed,shape,trials,successes,options\n0,2,five,1,\n", "not a table of trials"),
        ("seed,shape,trials,successes\n0,2,5,1\n", "not a table of trials"),
    ],
)
def test_a_damaged_table_is_named(tmp_path, text, reason):
    (make_run(tmp_path / "a") / "trials.csv").write_text(text)
    found, skipped = found_in(tmp_path)
    assert found == [] and len(skipped) == 1 and reason in skipped[0]


def test_trials_are_told_by_training_method_and_shape(tmp_path):
    transfer_run(tmp_path / "a", "0", 90)
    transfer_run(tmp_path / "b", "0", 100, seed=5)
    played(tmp_path / "a", (0, "0", 3, 0), name="fewer.csv")
    transfer_run(tmp_path / "c", "0", 80, "sacfd")
    transfer_run(tmp_path / "d", "0", 50, randomisation=Randomisation())
    found, skipped = found_in(tmp_path)
    assert told(found) == [
        ("CRSfD, 2 mm, randomised", "0", 950, 1000),
        ("SACfD, 2 mm, randomised", "0", 400, 500),
        ("CRSfD, 2 mm, no randomisation", "0", 250, 500),
    ]
    assert not skipped


def test_trials_of_other_tasks_or_options_are_not_added_up(tmp_path):
    transfer_run(tmp_path / "a", successes=99)
    transfer_run(tmp_path / "far", successes=50, shift=8.0)
    transfer_run(tmp_path / "some", successes=10, randomisation=Randomisation(friction=(1.0, 1.1)))
    transfer_run(tmp_path / "few", successes=70, demo_episodes=5)
    transfer_run(tmp_path / "joint", shape="all", successes=20)
    found, _ = found_in(tmp_path)
    assert sorted(told(found)) == [
        ("CRSfD, 2 mm, friction 1 1.1", "2", 50, 500),
        ("CRSfD, 2 mm, randomised", "2", 495, 500),
        ("CRSfD, 2 mm, randomised, 5 demonstrations", "2", 350, 500),
        ("CRSfD, 8 mm, randomised", "2", 250, 500),
        ("CRSfD, one policy for several shapes, 2 mm, randomised", "all", 100, 500),
    ]
    assert evidence.above(found, "2", 0.92).verdict == HOLDS
    assert "0.990" in evidence.above(found, "2", 0.92).numbers
    assert evidence.above(found, "3", 0.92).verdict == OPEN


def test_copies_of_runs_do_not_double_their_trials(tmp_path):
    transfer_run(tmp_path / "runs" / "a")
    shutil.copytree(tmp_path / "runs", tmp_path / "copy")
    found, skipped = found_in(tmp_path / "runs", tmp_path / "copy")
    assert told(found) == [("CRSfD, 2 mm, randomised", "2", 450, 500)]
    assert len(skipped) == 1 and "of no run that is shown" in skipped[0]
    # The same folder by another name.
    assert told(found_in(tmp_path / "runs", tmp_path / "runs" / ".." / "runs")[0]) == told(found)


def test_a_table_among_results_belongs_to_the_config_its_name_begins_with(tmp_path):
    run, results = transfer_run(tmp_path / "run", method="sacfd"), tmp_path / "results"
    results.mkdir()
    for name, copy in (("config.json", "a.json"), ("metrics.csv", "a.csv")):
        shutil.copy(run / name, results / copy)
    shutil.copy(run / "trials.csv", results / "a-trials.csv")
    shutil.copy(run / "trials.csv", results / "x.csv")
    found, skipped = found_in(results)
    assert told(found) == [("SACfD, 2 mm, randomised", "2", 450, 500)]
    assert len(skipped) == 1 and "x.csv: trials of no run" in skipped[0]


def test_the_options_of_the_trials_say_what_they_are_of_and_not_their_folder(tmp_path):
    run = make_run(tmp_path / "transfer" / "a")
    played(run, (0, "2", 9, 7), options="--episodes 9 --seed 3")
    played(run, (0, "2", 9, 1), options="--held-out", name="other.csv")
    played(run, (0, "3", 9, 9), options="--shape 3 --episodes 9", name="third.csv")
    found, skipped = found_in(tmp_path)
    assert [(t.held_out, t.shape, t.successes.tolist()) for t in found] == [
        (True, "2", [1]),
        (False, "2", [7]),
    ]
    assert len(skipped) == 1 and "conditions of their own (--shape 3)" in skipped[0]


def test_trials_on_the_task_of_training_are_told_by_shape_and_in_all(tmp_path):
    run = make_run(tmp_path / "a", shape="0,2", shift=8)
    played(run, (0, "0", 9, 7), (1, "0", 9, 8), (0, "2", 2, 1), options="")
    other = make_run(tmp_path / "b", shape="0,2", shift=8, demo_episodes=5)
    played(other, (0, "0", 9, 1), options="")
    found, _ = found_in(tmp_path)
    rows = tables.own_trials(found).rows
    assert [(*row[:3], row[-1]) for row in rows] == [
        ("CRSfD", "shape 0-2, shift 8 mm", "0", "15 of 18"),
        ("CRSfD", "shape 0-2, shift 8 mm", "2", "1 of 2"),
        ("CRSfD", "shape 0-2, shift 8 mm", "all", "16 of 20"),
        ("CRSfD, 5 demonstrations", "shape 0-2, shift 8 mm", "0", "1 of 9"),
    ]
    everything = trials.together(found[:2])
    assert everything.seeds.tolist() == [0, 1] and everything.trials.tolist() == [11, 9]
    assert found[0].cell.task == Task("0-2", 8.0)
    assert "16 of 20" in trial_sections.own(found) and trial_sections.own([]) == ""


def test_the_mean_over_shapes_takes_seeds_as_what_was_sampled(tmp_path):
    for shape, successes in (("0", 90), ("1", 100)):
        transfer_run(tmp_path / shape, shape, successes)
    found, _ = found_in(tmp_path)
    seeds = len(found[0].seeds)
    # As often with each seed, so what is left is chance: Wilson's interval of all trials.
    ends = intervals.wilson_interval(190 * seeds, 200 * seeds)
    assert trials.together(found).rate == pytest.approx((0.95, *ends))


def test_trials_of_a_run_that_is_beside_a_longer_one_do_not_count(tmp_path):
    transfer_run(tmp_path / "long", successes=90)
    played(
        make_run(
            tmp_path / "short", shift=2.0, steps=500, values=rising(0)[:5], randomisation=TRAINING
        ),
        (0, "2", 100, 10),
    )
    found, left_out = found_in(tmp_path)
    assert told(found) == [("CRSfD, 2 mm, randomised", "2", 450, 500)]
    assert len(left_out) == 1 and "or of a shorter one" in left_out[0]


@pytest.mark.parametrize(
    ("seeds", "values", "verdict"),
    [(5, None, HOLDS), (2, None, OPEN), (5, "half", OPEN)],
)
def test_trials_decide_once_enough_seeds_are_through(tmp_path, seeds, values, verdict):
    curve = rising(0, seeds=seeds)
    run = make_run(
        tmp_path / "run", shift=2.0, values=curve[:5] if values else curve, randomisation=TRAINING
    )
    played(run, *((seed, "2", 100, 100) for seed in range(seeds)))
    part = evidence.above(found_in(tmp_path)[0], "2", 0.92)
    assert part.verdict == verdict


def test_trials_are_drawn_where_they_are(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(transfer, "save", lambda canvas, path: drawn.append(canvas))
    transfer_run(tmp_path / "a", "0", 90)
    transfer_run(tmp_path / "b", "2", 20, randomisation=Randomisation())
    transfer.draw(found_in(tmp_path)[0], tmp_path / "transfer.png")
    (axes,) = drawn[0].axes
    points = [bars.lines[0] for bars in axes.containers]
    assert [list(line.get_ydata()) for line in points] == [[0.9], [0.2], [1.0, 0.92]]
    assert points[1].get_markerfacecolor() == "white"
    paper = axes.containers[2]
    assert paper.get_label() == "paper, real arm, 25 trials"
    # Wilson's interval of 25 of 25.
    assert paper.lines[2][0].get_segments()[0][:, 1] == pytest.approx([0.8668, 1.0], abs=1e-4)
    assert [text.get_text() for text in axes.get_xticklabels()] == ["0", "2"]


def test_runs_without_trials_have_none(tmp_path):
    make_run(tmp_path / "a")
    assert found_in(tmp_path) == ([], [])
    with pytest.raises(UserError):
        table.read(tmp_path / "none.csv")
