"""From run folders to a page: reading, sorting, comparing, judging and showing."""

import json
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image
from report_runs import STEPS, cells_of, make_run, paper_like, played, rising, transfer_run

from crsfd_jax import algorithms
from crsfd_jax.config import ALGORITHMS, Config, Potential, Replay, Sac
from crsfd_jax.curve import Curve
from crsfd_jax.errors import UserError
from crsfd_jax.options.randomisation import TRAINING, Randomisation
from crsfd_jax.report import __main__ as program
from crsfd_jax.report import cells as grouping
from crsfd_jax.report import (
    claims,
    evidence,
    figures,
    gaps,
    headline,
    html,
    layout,
    leads,
    page,
    pairing,
    runs,
    tables,
    trials,
    verdicts,
)
from crsfd_jax.report.cells import Task
from crsfd_jax.report.evidence import FAILS, HOLDS, OPEN
from crsfd_jax.report.methods import ARMS, BASELINES, WITHOUT_INTERACTION, style
from crsfd_jax.report.summary import compare, scores, summarise
from crsfd_jax.report.words import in_words
from crsfd_jax.storage import metrics


def test_runs_are_found_in_folders_and_as_tables_with_their_config(tmp_path):
    folder = make_run(tmp_path / "runs" / "deep" / "one", "sac", "3", 4)
    results = tmp_path / "results"
    results.mkdir()
    (results / "two.csv").write_bytes((folder / "metrics.csv").read_bytes())
    (results / "two.json").write_bytes((folder / "config.json").read_bytes())
    found = runs.find([tmp_path / "runs", results])
    assert [run.name for run in found.runs] == ["deep/one", "two"]
    for run in found.runs:
        assert run.options["algorithm"] == "sac" and run.options["sac.gamma"] == Config().sac.gamma
        np.testing.assert_allclose(run.curve.values, rising(200), atol=1e-8)
        assert run.wall_s == 100 and run.seeds.tolist() == [0, 1, 2, 3, 4]
    assert not found.skipped


def test_what_is_no_run_is_named_and_left_out(tmp_path):
    make_run(tmp_path / "good")
    make_run(tmp_path / "empty", values=np.zeros((0, 2)))
    damaged = make_run(tmp_path / "damaged")
    (damaged / "config.json").write_text('{"config": ')
    make_run(tmp_path / "foreign")
    described = json.loads((tmp_path / "foreign" / "config.json").read_text())
    described["config"]["shape"] = 2
    (tmp_path / "foreign" / "config.json").write_text(json.dumps(described))
    (tmp_path / "lonely.csv").write_text("env_steps,seed\n1,0\n")
    (tmp_path / "prices.csv").write_text("fruit,price\napple,1\n")
    found = runs.find([tmp_path])
    assert [run.name for run in found.runs] == ["good"]
    text = "\n".join(found.skipped)
    assert len(found.skipped) == 4
    for word in ("damaged", "empty", "shape is 2", "no lonely.json beside it"):
        assert word in text


def test_without_any_run_the_user_is_told(tmp_path):
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(UserError, match=r"no run with an evaluation found: .*no run in it"):
        runs.find([tmp_path])
    with pytest.raises(UserError, match="nowhere: is no folder"):
        runs.find([tmp_path / "nowhere"])


def test_options_that_an_older_run_does_not_know_have_their_default(tmp_path):
    folder = make_run(tmp_path / "old")
    described = json.loads((folder / "config.json").read_text())
    del described["config"]["potential"]["gamma"], described["config"]["envs"]
    (folder / "config.json").write_text(json.dumps(described))
    options = runs.find([folder]).runs[0].options
    assert options["potential.gamma"] == Config().potential.gamma
    assert options["envs"] == Config().envs


def test_seeds_from_several_folders_make_one_cell_and_repeats_are_left_out(tmp_path):
    make_run(tmp_path / "a", seed=0)
    make_run(tmp_path / "b", seed=5)
    make_run(tmp_path / "short", values=rising(200)[:4])
    found, left_out = grouping.gather(runs.find([tmp_path]).runs)
    assert len(found) == 1 and found[0].seeds.tolist() == list(range(10))
    assert found[0].finished and found[0].steps == 1000
    assert len(left_out) == 1 and "short: repeats seeds of a" in left_out[0]


def test_other_options_make_a_variant_and_not_the_same_cell(tmp_path):
    make_run(tmp_path / "a")
    make_run(tmp_path / "b", potential=Potential(gamma=0.9))
    plain, other = cells_of(tmp_path)
    assert plain.variant == "" and other.variant == "gamma_0 0.9"
    assert list(pairing.index([plain, other])) == [("crsfd", Task("2", 0.0))]


def test_methods_are_like_each_other_in_all_options_but_their_own(tmp_path):
    # Most runs of CRSfD have another reward scale, most of all runs do not.
    for seed, scale in ((0, 1.0), (5, 1.0), (10, 16.0)):
        make_run(tmp_path / f"c{seed}", seed=seed, sac=Sac(reward_scale=scale))
    for method in ("sacfd", "sqil"):
        make_run(tmp_path / method, method)
    make_run(tmp_path / "own", seed=15, potential=Potential(gamma=0.9))
    variants = {cell.method + cell.variant: len(cell.seeds) for cell in cells_of(tmp_path)}
    assert variants == {
        "crsfd": 5,
        "crsfdrewards times 1": 10,
        "crsfdgamma_0 0.9": 5,
        "sacfd": 5,
        "sqil": 5,
    }


def test_other_options_have_other_words(tmp_path):
    many = {"tau": 0.1, "learning_rate": 0.1, "gamma": 0.9, "batch_size": 64, "critics": 3}
    for seed in (0, 5, 10, 15):
        make_run(tmp_path / f"usual{seed}", seed=seed)
    for name, tau in (("c", 0.1), ("d", 0.2)):
        make_run(tmp_path / name, sac=Sac(**{**many, "tau": tau}))
    make_run(tmp_path / "e", "sacfd", sac=Sac(**{**many, "tau": 0.2}))
    found = {cell.runs[0].name: cell.variant for cell in cells_of(tmp_path)}
    assert found["usual0"] == "" and found["c"].endswith(", ...") and found["d"] != found["c"]
    assert found["e"] == found["d"]


def test_another_grid_of_the_same_name_is_another_task(tmp_path):
    for number, shape in enumerate(("my=##/##", "my=.#./###")):
        make_run(tmp_path / f"c{number}", shape=shape, seed=5 * number)
        make_run(tmp_path / f"s{number}", "sacfd", shape=shape, seed=5 * number)
    found = cells_of(tmp_path)
    assert len(found) == 4 and len({cell.task for cell in found}) == 2
    told = {str(cell.task) for cell in found}
    assert told == {"shape my=##/##, no shift", "shape my=.#./###, no shift"}
    assert not any(cell.variant for cell in found)


def test_a_shape_called_like_others_is_told_apart(tmp_path):
    for number, shape in enumerate(("2", "2=##", "all", "all=##")):
        make_run(tmp_path / f"c{number}", shape=shape)
    assert sorted(str(cell.task) for cell in cells_of(tmp_path)) == [
        "all shapes, no shift",
        "shape 2, no shift",
        "shape 2=##, no shift",
        "shape all=##, no shift",
    ]


def test_unfinished_seeds_wait_while_there_are_finished_ones(tmp_path):
    make_run(tmp_path / "a", values=rising(0))
    make_run(tmp_path / "b", values=rising(0)[:2], seed=5)
    (cell,), left_out = grouping.gather(runs.find([tmp_path]).runs)
    assert cell.seeds.tolist() == [0, 1, 2, 3, 4] and summarise(cell).mean == 1
    assert left_out == ["b: 200 of 1,000 steps, waits for its end: other seeds are there"]
    make_run(tmp_path / "other", values=rising(0)[:4])
    found = grouping.gather(runs.find([tmp_path / "other", tmp_path / "b"]).runs)[0]
    # Both unfinished: summed up where all seeds stand.
    assert len(found) == 1 and found[0].steps == 200
    assert summarise(found[0]).mean == pytest.approx(rising(0)[1].mean(), abs=1e-6)
    assert "stands at a mean success" in headline.sentences(found, [])[0]


def test_seeds_that_only_partly_overlap_are_paired_in_their_order(tmp_path):
    low = np.array([1.0, 1.0, 0.2, 0.2, 0.2])
    make_run(tmp_path / "a", values=np.ones((10, 5)))
    make_run(tmp_path / "b", "sacfd", values=np.ones((10, 5)) * low, seed=3)
    found = compare([tuple(cells_of(tmp_path))])
    assert found.final.value == pytest.approx(0.48) and found.final.low < 0.48


def test_two_cells_are_compared_by_the_seeds_that_both_have(tmp_path):
    values = np.ones((10, 5)) * np.array([1.0, 1.0, 0.4, 0.4, 0.4])
    make_run(tmp_path / "a", values=values)
    make_run(tmp_path / "b", "sacfd", values=np.ones((10, 2)))
    each = scores(*cells_of(tmp_path))
    assert each.seeds.tolist() == [0, 1] and each.final[0].tolist() == [1.0, 1.0]
    assert each.learned == (100.0, 100.0) and each.gap("area").tolist() == [0.0, 0.0]


def test_a_level_is_judged_by_the_runs_with_the_most_seeds(tmp_path):
    make_run(tmp_path / "a", values=rising(0, 0.3))
    make_run(tmp_path / "b", values=rising(0, 0.7, seeds=10)[:5], steps=500)
    part = evidence.below(pairing.index(cells_of(tmp_path)), Task("2", 0.0), "crsfd", 0.5)
    assert part.verdict == FAILS and part.numbers.endswith("0k steps")


def test_what_does_not_interact_is_compared_by_its_success_alone(tmp_path):
    make_run(tmp_path / "a", "crsfd")
    make_run(tmp_path / "b", "bc", values=rising(0, 0.5))
    over_all, each = tables.comparisons(cells_of(tmp_path), "crsfd")
    for row in (over_all.rows[0], each.rows[0]):
        said = dict(zip(over_all.head[2:], row[2:], strict=True))
        assert said["difference of area"] == said["IQM of area"] == said["P(better area)"] == "-"
        assert said["difference of final success"].startswith("+0.500")


def test_of_runs_with_the_same_seeds_the_one_with_more_of_them_counts(tmp_path):
    make_run(tmp_path / "a", values=rising(0, seeds=1))
    make_run(tmp_path / "b", values=rising(0, seeds=4))
    (cell,) = cells_of(tmp_path)
    assert cell.seeds.tolist() == [0, 1, 2, 3]


def test_a_method_that_does_not_interact_is_unfinished_before_its_last_step_too(tmp_path):
    make_run(tmp_path / "bc", "bc", values=rising(0, 0.2)[:5])
    (cell,) = cells_of(tmp_path)
    assert not cell.finished
    part = evidence.below(pairing.index([cell]), cell.task, "bc", 0.5)
    assert part.verdict == OPEN and "500 of 1,000" in part.numbers


@pytest.mark.parametrize(("capacity", "variants"), [(1_000, 1), (1_024, 1), (640, 2)])
def test_a_buffer_that_holds_a_part_of_the_run_makes_a_variant(tmp_path, capacity, variants):
    make_run(tmp_path / "a", replay=Replay(capacity=1_024))
    make_run(tmp_path / "b", seed=5, replay=Replay(capacity=1_024))
    make_run(tmp_path / "c", seed=10, replay=Replay(capacity=capacity))
    assert len(cells_of(tmp_path)) == variants


def test_crsfd_with_a_part_switched_off_is_that_ablation(tmp_path):
    make_run(tmp_path / "a", potential=Potential(free_space_weight=0.0))
    make_run(tmp_path / "b", potential=Potential(gamma=Config().sac.gamma))
    assert tuple(cell.method for cell in cells_of(tmp_path)) == ARMS
    assert all(cell.variant == "" for cell in cells_of(tmp_path))


def test_methods_are_named_as_their_files_and_known_not_to_interact():
    known = {"crsfd", *BASELINES, *ARMS}
    assert known <= set(ALGORITHMS)
    assert {n for n in known if not algorithms.load(n).interacts} == set(WITHOUT_INTERACTION)


def test_every_method_has_a_look_of_its_own():
    known = {"crsfd", "rlpd", *BASELINES, *ARMS}
    assert len({(style(name).colour, style(name).dashes) for name in known}) == len(known)
    assert style("crsfd").width > max(style(n).width for n in known - {"crsfd"})


def test_a_method_that_does_not_interact_has_one_level(tmp_path):
    values = rising(200, top=0.5)
    (cell,) = cells_of(make_run(tmp_path / "bc", "bc", values=values))
    np.testing.assert_allclose(cell.curve.values, values[None, -2:].mean(axis=1), atol=1e-8)
    assert cell.finished and summarise(cell).area == pytest.approx(values[-2:].mean())


def test_a_cell_is_summed_up_as_worked_out_by_hand(tmp_path):
    values = np.array([[0.0, 0.0], [0.8, 1.0], [0.9, 1.0], [1.0, 1.0]])
    (cell,) = cells_of(make_run(tmp_path / "a", values=values, steps=400))
    found = summarise(cell)
    assert (found.mean, found.std, found.steps_to_level) == (1, 0, 200)
    assert found.seeds_at_level == 1 and found.wall_s == 40
    assert found.area == pytest.approx(np.mean([(0.4 + 0.85 + 0.95) / 4, (0.5 + 1 + 1) / 4]))


def test_methods_are_compared_up_to_the_steps_that_both_have_made(tmp_path):
    make_run(tmp_path / "a", values=rising(0))
    make_run(tmp_path / "b", "sacfd", values=rising(300)[:5], steps=500)
    found = compare([tuple(cells_of(tmp_path))])
    assert found.steps == (500,)
    ours, theirs = (np.append(0, rising(start)[:5, 0]) for start in (0, 300))
    expected = np.trapezoid(ours - theirs, dx=100) / 500
    assert found.area.value == pytest.approx(expected, abs=0.02)
    assert found.better_area == (1, 1, 1)


def test_the_policy_that_explores_is_compared_by_the_episodes_of_training(tmp_path):
    for name, method, success in (("a", "crsfd", 0.75), ("b", "sacfd", 0.5)):
        table = make_run(tmp_path / name, method) / "metrics.csv"
        head, *rows = table.read_text().splitlines()
        # None had ended by the first evaluation.
        told = [f"{row},{success},{0 if row.startswith('100,') else 9}" for row in rows]
        head += ",train/success_rate,train/episodes"
        table.write_text("\n".join([head, *told]) + "\n")
    found = compare([tuple(cells_of(tmp_path))])
    assert found.area == (0, 0, 0)
    # From 0 at the start to the level at 200 of 1000 steps.
    assert found.exploring == pytest.approx([0.25 * 0.9] * 3)


def test_exploring_compares_whole_stretches_however_often_they_were_evaluated(tmp_path):
    rate = np.linspace(0.1, 1.0, 10)
    for name, method, every in (("a", "crsfd", 1), ("b", "sacfd", 5)):
        table = make_run(tmp_path / name, method, every=every) / "metrics.csv"
        head, *rows = table.read_text().splitlines()
        told = []
        for row in rows:
            last = int(row.split(",")[0]) // 100
            # Ten episodes in each 100 steps: the same learner, looked at more or less often.
            told.append(f"{row},{rate[last - every : last].mean()},{10 * every}")
        table.write_text("\n".join([head + ",train/success_rate,train/episodes", *told]) + "\n")
    assert compare([tuple(cells_of(tmp_path))]).exploring == pytest.approx((0, 0, 0), abs=1e-6)


def test_methods_without_episodes_of_training_are_not_compared_by_them(tmp_path):
    make_run(tmp_path / "a")
    make_run(tmp_path / "b", "bc")
    assert compare([tuple(cells_of(tmp_path))]).exploring is None


def test_equal_curves_compare_as_equal_however_often_they_were_evaluated(tmp_path):
    make_run(tmp_path / "a", values=rising(100), every=3)
    make_run(tmp_path / "b", "sacfd", values=rising(100)[:7], steps=700)
    found = compare([tuple(cells_of(tmp_path))])
    assert found.steps == (600,)
    assert found.area == found.final == (0, 0, 0)


def test_of_runs_of_several_lengths_those_with_most_evaluations_in_common_are_compared(tmp_path):
    make_run(tmp_path / "long", every=5)
    make_run(tmp_path / "short", values=rising(100)[:6], steps=600)
    make_run(tmp_path / "rival", "sqil", values=rising(100)[:6], steps=600)
    make_run(tmp_path / "other", "sacfd", every=5)
    found = cells_of(tmp_path)
    assert [cell.steps for cell in found] == [1000, 600, 1000, 600]
    ((ours, theirs),) = pairing.rivals(found, "crsfd")["sqil"]
    assert (ours.steps, theirs.steps) == (600, 600)
    ((ours, theirs),) = pairing.rivals(found, "crsfd")["sacfd"]
    assert (ours.steps, theirs.steps) == (1000, 1000)
    assert [cell.steps for cell in pairing.longest(found)] == [1000, 1000, 600]
    part = evidence.ahead(pairing.index(found), [Task("2", 0.0)], "crsfd", "sqil", "area")
    assert "+0.000 [+0.000, +0.000]" in part.numbers
    short, figure = layout.figures(found)
    assert [cell.steps for cell in short.panels[0].cells] == [600, 600]
    assert [cell.steps for cell in figure.panels[0].cells] == [1000, 1000, 600]
    assert not [line for line in gaps.lines(found, [figure]) if "CRSfD" in line]
    assert any("SQIL was given 600 steps, others 1,000" in line for line in gaps.lines(found, []))


def test_of_several_lengths_the_one_that_all_tasks_and_most_seeds_have_is_compared(tmp_path):
    for method, start in (("crsfd", 0), ("sqil", 200)):
        short = {"values": rising(start)[:6], "steps": 600}
        make_run(tmp_path / f"{method}1", method, "1", values=rising(start))
        make_run(tmp_path / f"{method}2", method, "1", **short)
        make_run(tmp_path / f"{method}3", method, "1", seed=5, **short)
        make_run(tmp_path / f"{method}4", method, "3", **short)
        make_run(tmp_path / f"{method}5", method, "4", values=rising(start))
        make_run(tmp_path / f"{method}6", method, "4", **short)
    make_run(tmp_path / "bc", "bc", "3")
    book = pairing.index(cells_of(tmp_path))

    def steps(shapes, theirs="sqil"):
        tasks = [Task(shape, 0.0) for shape in shapes]
        kept = pairing.pairs([(book["crsfd", task], book[theirs, task]) for task in tasks])
        return [(ours.steps, other.steps) for ours, other in kept]

    assert steps("1") == [(600, 600)], "ten seeds before five"
    assert steps("4") == [(1000, 1000)], "of as many seeds, more evaluations"
    assert steps("34") == [(600, 600)] * 2, "as many steps on all tasks"
    assert steps("14") == [(1000, 1000)] * 2, "the fewest seeds of a task count"
    assert steps("3", "bc") == [(600, 1000)], "what does not interact has any number of steps"
    part = evidence.ahead(book, [Task("1", 0.0), Task("3", 0.0)], "crsfd", "sqil", "area")
    assert part.numbers.endswith("1k steps") and part.verdict == HOLDS


def test_leads_are_those_of_equal_steps_and_variant_variants_last(tmp_path, monkeypatch):
    few = {"demo_episodes": 1}
    for name, method, start in (("a", "crsfd", 0), ("b", "sacfd", 200)):
        make_run(tmp_path / f"{name}1", method, values=rising(start))
        make_run(tmp_path / f"{name}2", method, values=rising(start)[:5], steps=500)
        make_run(tmp_path / f"{name}3", method, values=rising(2 * start)[:5], steps=500, **few)
        make_run(tmp_path / f"{name}4", method, "3", values=rising(start), seed=5)
    make_run(tmp_path / "alone", "crsfd", "4")
    found = leads.find(cells_of(tmp_path))
    assert [lead.label for lead in found] == [
        "shape 2, no shift, 0.5k steps",
        "shape 2, no shift, 1 demonstration, 0.5k steps",
        "shape 2, no shift, 1k steps",
        "shape 3, no shift, 1k steps",
    ]
    ours, theirs = (np.append(0, rising(start)[:, 0]) for start in (0, 200))
    assert found[2].area.value == pytest.approx(
        np.trapezoid(ours - theirs, dx=100) / 1000, abs=0.01
    )
    drawn = []
    monkeypatch.setattr(leads, "save", lambda canvas, path: drawn.append(canvas))
    leads.draw(found, tmp_path / "leads.png")
    (axes,) = drawn[0].axes
    points = axes.containers[0].lines[0]
    assert points.get_xdata().tolist() == [lead.area.value for lead in found]
    assert [text.get_text() for text in axes.get_yticklabels()] == [lead.label for lead in found]


def test_leads_name_the_options_that_sacfd_alone_has(tmp_path):
    make_run(tmp_path / "a", "crsfd")
    make_run(tmp_path / "b", "sacfd")
    make_run(tmp_path / "c", "crsfd", potential=Potential(gamma=0.9))
    make_run(tmp_path / "d", "sacfd", values=rising(0), replay=Replay(draw_demos="no"))
    found = {lead.label: lead.area.value for lead in leads.find(cells_of(tmp_path))}
    assert set(found) == {
        "shape 2, no shift, 1k steps",
        "shape 2, no shift, SACfD: no demonstrations in batches, 1k steps",
    }
    early = found["shape 2, no shift, SACfD: no demonstrations in batches, 1k steps"]
    assert early == pytest.approx(-0.2, abs=0.01)


def test_unfinished_runs_have_a_lead(tmp_path):
    for method in ("crsfd", "sacfd"):
        make_run(tmp_path / method, method, values=rising(0)[:5])
    assert [lead.label for lead in leads.find(cells_of(tmp_path))] == [
        "shape 2, no shift, 1k steps"
    ]


def test_figures_are_laid_out_as_in_the_paper(tmp_path):
    paper_like(tmp_path)
    drawn = {figure.name: figure for figure in layout.figures(cells_of(tmp_path))}
    assert list(drawn) == ["setting1", "setting2", "setting2_wide", "ablation"]
    titles = [panel.title for panel in drawn["setting1"].panels]
    assert titles == [f"shape {shape}, no shift" for shape in "1234"]
    assert all(len(panel.cells) == 9 for panel in drawn["setting1"].panels)
    assert drawn["setting2"].columns == 3
    assert [panel.title for panel in drawn["setting2"].panels][2:4] == [
        "shape 2, shift 8 mm",
        "shape 0, shift 4 mm",
    ]
    (wide,) = drawn["setting2_wide"].panels
    assert wide.title == "shape 2, shift 8 mm" and len(wide.cells) == 9
    assert [len(panel.cells) for panel in drawn["ablation"].panels] == [3, 3, 3, 3]


def test_shorter_runs_on_new_shapes_have_their_own_figure_and_the_ablation_equal_steps(tmp_path):
    paper_like(tmp_path)
    for shape in "13":
        for method in ("crsfd", "sqil"):
            make_run(tmp_path / f"long{method}{shape}", method, shape, steps=2000)
    drawn = {figure.name: figure for figure in layout.figures(cells_of(tmp_path))}
    assert list(drawn) == ["setting1", "setting1_1k", "setting2", "setting2_wide", "ablation"]
    planned = {
        name: [{c.method: c.planned_steps for c in p.cells} for p in drawn[name].panels]
        for name in ("setting1", "setting1_1k", "ablation")
    }
    assert [panel["crsfd"] for panel in planned["setting1"]] == [2000, 1000, 2000, 1000]
    assert [panel["sac"] for panel in planned["setting1"]] == [1000] * 4
    assert [len(panel.cells) for panel in drawn["setting1_1k"].panels] == [9] * 4
    assert {steps for panel in planned["setting1_1k"] for steps in panel.values()} == {1000}
    assert [panel["crsfd"] for panel in planned["ablation"]] == [1000] * 4


def test_a_legend_says_which_methods_have_shorter_runs_only(tmp_path, monkeypatch):
    for method, steps in (("crsfd", 2000), ("crsfd", 1000), ("sqil", 1000), ("bc", 1000)):
        make_run(tmp_path / f"{method}{steps}", method, steps=steps)
    drawn = []
    monkeypatch.setattr(figures, "save", lambda canvas, path: drawn.append(canvas))
    panel = layout.Panel("shape 2", tuple(cells_of(tmp_path)))
    figures.draw(layout.Figure("one", "", 1, (panel,)), tmp_path / "one.png")
    (legend,) = drawn[0].legends
    words = [text.get_text() for text in legend.get_texts()]
    assert words == ["CRSfD", "SQIL, 1k steps", "BC, no steps"]


def test_runs_that_fit_no_figure_of_the_paper_get_a_panel_for_each_task(tmp_path):
    make_run(tmp_path / "a", "crsfd", "2", 1)
    make_run(tmp_path / "b", "sac", "2", 1)
    make_run(tmp_path / "c", "crsfd", "all", 1)
    (figure,) = layout.figures(cells_of(tmp_path))
    assert [(panel.title, len(panel.cells)) for panel in figure.panels] == [
        ("shape 2, shift 1 mm", 2),
        ("all shapes, shift 1 mm", 1),
    ]


def test_variants_stand_in_the_order_of_their_numbers_and_equal_steps_together(tmp_path):
    for count in (10, 5, 1):
        for method in ("crsfd", "sacfd"):
            make_run(tmp_path / f"{method}{count}", method, shift=1, demo_episodes=count)
    for method in ("crsfd", "sacfd", "sac"):
        make_run(tmp_path / method, method, shift=1)
    make_run(tmp_path / "long", "sac", "3", steps=2000)
    drawn = {figure.name: figure for figure in layout.figures(cells_of(tmp_path))}
    assert list(drawn) == ["tasks_1k", "tasks_2k"]
    titles = [panel.title.split(", ")[-1] for panel in drawn["tasks_1k"].panels]
    assert titles == ["shift 1 mm", "1 demonstration", "5 demonstrations", "10 demonstrations"]


def test_every_cell_is_drawn_somewhere(tmp_path):
    paper_like(tmp_path)
    make_run(tmp_path / "x", "gail", "2", 8)
    make_run(tmp_path / "y", "crsfd", "1", potential=Potential(gamma=0.9))
    found = cells_of(tmp_path)
    drawn = {id(c) for figure in layout.figures(found) for p in figure.panels for c in p.cells}
    assert drawn == {id(cell) for cell in found}


@pytest.mark.parametrize(
    ("ours", "theirs", "verdict"),
    [
        (rising(0), rising(300), HOLDS),
        (rising(300), rising(0), FAILS),
        (rising(0), rising(0), FAILS),
        (rising(0), rising(0)[:, ::-1] * np.array([0.1, 1, 1, 1, 1]), OPEN),
    ],
)
def test_being_ahead_is_judged_by_the_interval_of_the_difference(tmp_path, ours, theirs, verdict):
    make_run(tmp_path / "a", values=ours)
    make_run(tmp_path / "b", "sacfd", values=theirs)
    book = pairing.index(cells_of(tmp_path))
    part = evidence.ahead(book, [Task("2", 0.0)], "crsfd", "sacfd", "area")
    assert part.verdict == verdict, part.numbers


@pytest.mark.parametrize(("late", "verdict"), [(0, HOLDS), (40, OPEN), (300, FAILS)])
def test_being_alike_is_judged_by_the_margin(tmp_path, late, verdict):
    spread = late + np.array([-30, -20, 0, 40, 0]) * (late > 0)
    theirs = np.stack([rising(start, seeds=1)[:, 0] for start in spread], axis=1)
    make_run(tmp_path / "a", values=np.repeat(rising(0, seeds=1), 5, axis=1))
    make_run(tmp_path / "b", "sacfd", values=theirs)
    book = pairing.index(cells_of(tmp_path))
    part = evidence.close(book, Task("2", 0.0), "crsfd", "sacfd", "area")
    assert part.verdict == verdict, part.numbers


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        (None, "no run of SACfD"),
        (dict(values=rising(0)[:5]), "SACfD stands at 500 of 1,000 steps"),
        (dict(values=rising(0, seeds=2)), "SACfD has 2 seeds"),
    ],
)
def test_nothing_is_decided_without_data(tmp_path, other, reason):
    make_run(tmp_path / "a")
    if other:
        make_run(tmp_path / "b", "sacfd", **other)
    book = pairing.index(cells_of(tmp_path))
    part = evidence.ahead(book, [Task("2", 0.0)], "crsfd", "sacfd", "final")
    assert part.verdict == OPEN and reason in part.numbers


def test_claims_hold_on_runs_that_come_out_as_the_paper_says(tmp_path):
    paper_like(tmp_path)
    rates = zip("01234", (100, 100, 93, 94, 97), strict=True)
    for shape, successes in rates:
        transfer_run(tmp_path / f"transfer{shape}", shape, successes)
    cells = cells_of(tmp_path)
    found = claims.judge(cells, trials.find([tmp_path], cells)[0])
    assert {claim.statement: claim.verdict for claim in found if claim.verdict != HOLDS} == {}


def test_claims_do_not_hold_on_runs_that_come_out_the_other_way(tmp_path):
    paper_like(tmp_path)
    for run in [path for path in tmp_path.iterdir() if path.is_dir()]:
        text = (run / "config.json").read_text()
        swap = {"crsfd": "sacfd", "sacfd": "crsfd", "bc": "sqil", "sqil": "bc"}
        old = json.loads(text)["config"]["algorithm"]
        new = text.replace(f'"algorithm": "{old}"', f'"algorithm": "{swap.get(old, old)}"')
        (run / "config.json").write_text(new)
    played(make_run(tmp_path / "transfer", shift=2.0, randomisation=TRAINING), (0, "2", 10, 8))
    cells = cells_of(tmp_path)
    found = claims.judge(cells, trials.find([tmp_path], cells)[0])
    judged = {claim.statement.split(":")[0][:40]: claim.verdict for claim in found}
    assert [*judged.values()][:4] == [FAILS, FAILS, HOLDS, FAILS]
    assert judged["Shaping brings no bias into what is lear"] == FAILS
    assert [*judged.values()][9:] == [HOLDS, FAILS, FAILS, FAILS, FAILS, FAILS, OPEN]


@pytest.mark.parametrize(
    ("ours", "theirs", "verdict"), [(0, 0, OPEN), (0, 300, HOLDS), (300, 0, FAILS)]
)
def test_learning_later_is_judged_by_the_steps_to_the_level(tmp_path, ours, theirs, verdict):
    make_run(tmp_path / "a", values=rising(ours))
    make_run(tmp_path / "b", "sacfd", values=rising(theirs))
    book = pairing.index(cells_of(tmp_path))
    part = evidence.later(book, Task("2", 0.0), "crsfd", "sacfd")
    assert part.verdict == verdict and "against" in part.numbers


@pytest.mark.parametrize(("top", "verdict"), [(1.0, HOLDS), (0.93, HOLDS), (0.8, FAILS)])
def test_being_no_worse_is_judged_by_the_margin_on_one_side(tmp_path, top, verdict):
    make_run(tmp_path / "a", values=rising(0, top))
    make_run(tmp_path / "b", "sacfd", values=rising(0, 0.97))
    book = pairing.index(cells_of(tmp_path))
    assert evidence.no_worse(book, Task("2", 0.0), "crsfd", "sacfd").verdict == verdict


def test_the_claims_are_listed_in_a_file_of_their_own():
    no, yes = evidence.Part(FAILS, "0.1 [0.0, 0.2]"), evidence.Part(HOLDS, "0.3 [0.2, 0.4]")
    found = [evidence.claim("It is so", [yes, no]), evidence.claim("Too", [yes])]
    text = verdicts.document(found, ["3 runs"])
    assert "| does not hold | It is so | 1 does not hold, 1 holds |" in text
    assert text.index("- does not hold: 0.1 [0.0, 0.2]") < text.index("- holds: 0.3 [0.2, 0.4]")
    assert text.index("- 3 runs") < text.index("It is so") < text.index(evidence.RULES[0])


def test_a_claim_fails_with_one_part_and_holds_with_all():
    yes, no, unknown = (evidence.Part(verdict, "") for verdict in (HOLDS, FAILS, OPEN))
    assert evidence.claim("", [yes, yes]).verdict == HOLDS
    assert evidence.claim("", [yes, unknown]).verdict == OPEN
    assert evidence.claim("", [yes, unknown, no]).verdict == FAILS


def test_a_mean_curve_has_the_steps_at_which_every_seed_was_evaluated():
    values = np.array([[0.1, np.nan], [0.2, 0.4], [0.3, np.nan], [0.5, 0.7]])
    common = figures.at_common_steps(Curve(np.arange(4), values))
    assert common.env_steps.tolist() == [1, 3] and np.isfinite(common.values).all()
    apart = Curve(np.arange(2), np.array([[0.1, np.nan], [np.nan, 0.2]]))
    assert figures.at_common_steps(apart) is apart


def test_a_randomised_run_is_no_run_of_the_plain_task(tmp_path):
    make_run(tmp_path / "a", "sacfd")
    make_run(tmp_path / "b")
    make_run(tmp_path / "c", randomisation=TRAINING)
    assert [cell.variant for cell in cells_of(tmp_path)] == ["", "randomised", ""]


def test_a_variant_that_several_methods_have_is_a_panel_of_its_own(tmp_path):
    for method in ("crsfd", "sacfd"):
        make_run(tmp_path / f"{method}1", method)
        make_run(tmp_path / f"{method}2", method, seed=5)
        make_run(tmp_path / f"{method}3", method, demo_episodes=1)
    make_run(tmp_path / "alone", "crsfd", engine="mjx")
    figure = layout.figures(cells_of(tmp_path))[-1]
    panels = {panel.title: [cell.variant for cell in panel.cells] for panel in figure.panels}
    plain, few = sorted(panels)
    assert few == f"{plain}, 1 demonstration" and panels[few] == ["", ""]
    assert sorted(panels[plain]) == ["", "", "engine mjx"]


def test_a_variant_stands_beside_usual_runs_over_as_many_steps(tmp_path):
    for method in ("crsfd", "sacfd"):
        make_run(tmp_path / f"{method}1", method, steps=2000)
        make_run(tmp_path / f"{method}2", method)
    make_run(tmp_path / "few", demo_episodes=1)
    make_run(tmp_path / "long", demo_episodes=5, steps=2000)
    drawn = {figure.name: figure.panels for figure in layout.figures(cells_of(tmp_path))}
    found = {
        name: sorted((cell.method, cell.variant, cell.planned_steps) for cell in panel.cells)
        for name, (panel,) in drawn.items()
    }
    assert found == {
        f"tasks_{k}k": [
            ("crsfd", "", 1000 * k),
            ("crsfd", variant, 1000 * k),
            ("sacfd", "", 1000 * k),
        ]
        for k, variant in ((1, "1 demonstration"), (2, "5 demonstrations"))
    }


def test_a_panel_whose_runs_are_all_of_one_variant_is_named_by_it(tmp_path):
    make_run(tmp_path / "a")
    make_run(tmp_path / "b", "sacfd")
    make_run(tmp_path / "c", shift=2.0, randomisation=TRAINING)
    panels = layout.figures(cells_of(tmp_path))[-1].panels
    moved = next(panel for panel in panels if "2 mm" in panel.title)
    assert moved.title == "shape 2, shift 2 mm, randomised"
    assert [cell.variant for cell in moved.cells] == [""]


def test_of_one_drawn_quantity_the_variant_tells_the_range(tmp_path):
    make_run(tmp_path / "a")
    make_run(tmp_path / "b", "sacfd")
    make_run(tmp_path / "c", randomisation=Randomisation(socket_yaw=(-0.05, 0.05)))
    assert [c.variant for c in cells_of(tmp_path)] == [
        "",
        "hole turned by -0.05 to 0.05 rad",
        "",
    ]


def test_what_is_missing_is_said(tmp_path):
    paper_like(tmp_path)
    for name in ("gail3", "gail4", "sac2", "rsgm1"):
        for file in ("config.json", "metrics.csv"):
            (tmp_path / name / file).unlink()
    make_run(tmp_path / "new1", "sac", "2", values=rising(0)[:4])
    make_run(tmp_path / "new2", "rsgm", "1", values=rising(0, seeds=3)[:5], steps=500)
    found = cells_of(tmp_path)
    said = gaps.lines(found, layout.figures(found))
    assert sorted(said) == [
        "RS-GM has 3 seeds, most have 5: shape 1, no shift",
        "RS-GM was given 500 steps, others 1,000: shape 1, no shift",
        "SAC is unfinished, 400 of 1,000 steps: shape 2, no shift",
        "no run of GAIL: shape 3, no shift; shape 4, no shift",
    ]


def test_panels_of_what_fits_no_figure_of_the_paper_lack_nothing(tmp_path):
    make_run(tmp_path / "a", "crsfd", "0")
    make_run(tmp_path / "b", "sacfd", "0")
    make_run(tmp_path / "c", "crsfd", "0", shift=2.0)
    found = cells_of(tmp_path)
    drawn = layout.figures(found)
    assert [figure.name for figure in drawn] == ["tasks_1k"] and len(drawn[0].panels) == 2
    assert gaps.lines(found, drawn) == []


def test_the_headline_names_the_closest_rival(tmp_path):
    paper_like(tmp_path)
    found = cells_of(tmp_path)
    said = " ".join(headline.sentences(found, []))
    assert "CRSfD ends at a mean success of 1.000 over 10 tasks" in said
    assert "It learns faster than SACfD, the closest of 7 others on 5 tasks:" in said


def test_the_headline_compares_methods_on_the_same_tasks(tmp_path):
    # On shape 1 the newcomer is closer than SACfD, whose mean over both shapes is smaller still;
    # it has fewer steps, whose areas are no measure.
    for shape, lead in (("1", 100), ("2", 1)):
        make_run(tmp_path / f"ours{shape}", "crsfd", shape, values=rising(0))
        make_run(tmp_path / f"sacfd{shape}", "sacfd", shape, values=rising(lead))
    said = " ".join(headline.sentences(cells_of(tmp_path), []))
    assert "faster than SACfD, the only other method on 2 tasks:" in said
    make_run(tmp_path / "new1", "newcomer", "1", values=rising(60)[:3], steps=300)
    make_run(tmp_path / "own1", "crsfd", "1", values=rising(0)[:3], steps=300)
    make_run(tmp_path / "other1", "rlpd", "1", values=rising(300))
    said = " ".join(headline.sentences(cells_of(tmp_path), []))
    assert "faster than newcomer, the closest of 3 others on shape 1, no shift:" in said


def test_the_headline_weighs_areas_by_the_steps_they_are_of(tmp_path):
    # By 90 of 1,000 steps on one task, and by 6 of 200 the other way round: 42 in the mean.
    for name, method, starts in (("a", "crsfd", (0, 100)), ("b", "sacfd", (90, 0))):
        late, early = (np.clip((np.array(STEPS)[:, None] - s) / 300, 0, 1) for s in starts)
        make_run(tmp_path / f"{name}1", method, "1", values=np.repeat(late, 5, axis=1))
        short = np.repeat(early[:2], 5, axis=1)
        make_run(tmp_path / f"{name}2", method, "2", values=short, steps=200)
    found = cells_of(tmp_path)
    each = [scores(*pair) for pair in pairing.rivals(found, "crsfd")["sacfd"]]
    steps = [task.steps * float(task.gap("area").mean()) for task in each]
    assert steps[0] > 0 > steps[1] and each[0].gap("area").mean() + each[1].gap("area").mean() < 0
    said = " ".join(headline.sentences(found, []))
    assert f"is worth {np.mean(steps):+,.0f} [" in said and "learns faster than SACfD" in said


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(7.4, "7 s"), (150, "2 min"), (3600, "1 h 00 min"), (float("nan"), "not recorded")],
)
def test_durations_are_words(seconds, words):
    assert tables.duration(seconds) == words


class Page(HTMLParser):
    """Checks that tags are closed in order and collects where pictures come from."""

    def __init__(self):
        super().__init__()
        self.open, self.sources, self.text = [], [], []

    def handle_starttag(self, tag, attrs):
        self.sources += [value for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def stub_map(path):
    Image.new("RGB", (4, 4)).save(path)
    return "a map"


def test_the_page_needs_nothing_but_itself(tmp_path):
    make_run(tmp_path / "r" / "a", "crsfd", demos="<b>mine</b>")
    make_run(tmp_path / "r" / "b", "crsfd", values=rising(200)[:3])
    make_run(tmp_path / "r" / "c", "sacfd")
    (tmp_path / "r" / "a" / "clips").mkdir()
    for name in ("clip", "clips/9", "clips/20", "clips/100", "clips/3000"):
        Image.new("RGB", (9, 9)).save(tmp_path / "r" / "a" / f"{name}.gif", "GIF")
    out = tmp_path / "out"
    file = page.write(page.collect([str(tmp_path / "r")]), out, stub_map)
    parsed = Page()
    parsed.feed(file.read_text())
    assert not parsed.open
    films = [source for source in parsed.sources if source.startswith("data:image/gif")]
    assert len(films) == 4 and len(parsed.sources) == 6
    assert all(source.startswith("data:image/") for source in parsed.sources)
    text = " ".join(parsed.text)
    ages = [age for age in (9, 20, 100, 3000) if f", {age:,} steps" in text]
    assert ages == [9, 100, 3000]
    assert "demonstrations <b>mine</b>" in text and "a map" in text and "1.2.3" in text
    assert Image.open(out / "tasks_1k.png").width > 400
    again = page.write(page.collect([str(tmp_path / "r")]), tmp_path / "again", stub_map)
    assert again.read_text() == file.read_text()


def test_figures_come_first_and_other_options_are_folded_away(tmp_path):
    make_run(tmp_path / "r" / "a", "crsfd")
    make_run(tmp_path / "r" / "b", "crsfd", seed=5)
    make_run(tmp_path / "r" / "c", "crsfd", potential=Potential(gamma=0.9))
    text = page.write(page.collect([str(tmp_path / "r")]), tmp_path / "out", stub_map).read_text()
    results, folded = text.index("<h2>Results"), text.index("<summary>with other options")
    assert text.index("data:image") < results < text.index(">CRSfD<") < folded
    assert folded < text.index(">CRSfD, gamma_0 0.9<") < text.index("</details>", folded)
    alone = page.write(page.collect([str(tmp_path / "r" / "a")]), tmp_path / "one", stub_map)
    assert "with other options" not in alone.read_text()


def test_films_that_would_make_the_page_too_large_are_named(tmp_path, monkeypatch):
    for name, size in (("a", 3), ("b", 9)):
        make_run(tmp_path / "r" / name, "crsfd" if name == "a" else "sacfd")
        (tmp_path / "r" / name / "film.gif").write_bytes(bytes(size))
    monkeypatch.setattr(page, "MAX_FILM_BYTES", 10)
    file = page.write(page.collect([str(tmp_path / "r")]), tmp_path / "out", stub_map)
    text = file.read_text()
    assert text.count("data:image/gif") == 1 and "r/b/film.gif: no room" in text


def test_troubles_of_a_run_are_on_the_page_and_nothing_where_there_were_none(tmp_path):
    folder = make_run(tmp_path / "r" / "hurt")
    make_run(tmp_path / "r" / "well", "sacfd")
    table = metrics.read(folder / "metrics.csv")
    (folder / "metrics.csv").unlink()
    table["train/diverged"] = (table["seed"] == 3) & (table["env_steps"] >= 400)
    table["env/contact_limit"] = table["seed"] == 1
    rows = [dict(zip(table, line, strict=True)) for line in zip(*table.values(), strict=True)]
    metrics.append(folder / "metrics.csv", rows)
    shown = page._origin(page.collect([str(tmp_path / "r")]))
    assert "hurt: seed 3 diverged at 400 steps" in shown
    assert "hurt: contacts filled their room in 10 of 5,000 control steps" in shown
    assert "well:" not in shown
    assert "troubles" not in page._origin(page.collect([str(tmp_path / "r" / "well")]))


def test_the_program_reports_and_refuses(tmp_path, monkeypatch, capsys):
    pytest.importorskip("jax")
    from crsfd_jax.report import value_map

    monkeypatch.setattr(value_map, "draw_of", lambda cells, path: stub_map(path))
    make_run(tmp_path / "a")
    (tmp_path / "b.csv").write_text("env_steps,seed\n")
    assert program.run([str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert f"written   {tmp_path}/report/report.html" in said and "left out" in said
    with pytest.raises(UserError, match="is no folder"):
        program.run([str(tmp_path / "none")])
    with pytest.raises(UserError, match="--out"):
        program.run([str(tmp_path), "--out", str(tmp_path / "b.csv" / "x")])


def test_html_is_escaped():
    assert html.table(("<a>",), [("&",)], 1).count("&lt;a&gt;") == 1
    assert "<i>" not in html.bullets(["<i>"]) + html.paragraph("<i>") + html.page("<i>", [])


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"scene.clearance": 3e-4}, "clearance 0.3 mm"),
        ({"demo_episodes": 5, "demos": "noise3.npz"}, "5 demonstrations, demonstrations noise3"),
        ({"sac.gamma": 0.96, "sac.reward_scale": 1.0}, "gamma_k 0.96, rewards times 1"),
        ({"potential.terminal": "keep"}, "potential at success kept"),
        ({"potential.spread": 0.0}, "demonstrations spread 0 mm"),
        ({"sac.hidden": (64, 64)}, "sac.hidden 64 64"),
        ({name: 1 for name in "abcd"}, "a 1, b 1, c 1, ..."),
    ],
)
def test_options_are_called_by_what_they_mean(changed, words):
    assert in_words(changed, Randomisation()) == words


def test_what_is_drawn_has_one_word_where_it_is_all_or_nothing():
    drawn = {"randomisation.friction": (1.0, 2.0), "randomisation.delay": 0.5, "sac.gamma": 0.9}
    assert in_words(drawn, TRAINING) == "randomised, gamma_k 0.9"
    assert in_words(drawn, Randomisation()) == "no randomisation, gamma_k 0.9"
    some = Randomisation(friction=(1.0, 2.0))
    assert in_words({"randomisation.friction": (1.0, 2.0)}, some) == "friction 1 2"
