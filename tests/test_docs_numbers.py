"""The numbers of the documents are those that the report makes of the committed curves."""

import re
import runpy

import pytest
from test_docs import PAGES, ROOT

from crsfd_jax.report import numbers, page, tables, verdicts

RESULTS = ROOT / "docs" / "results"
CLAIMS = RESULTS / verdicts.FILE
COUNTED = re.compile(r"Of (\d+) claims \[?(\d+) hold, (\d+) do not and (\d+) (?:is|are) undecided")
FROM = {
    RESULTS: "results",
    RESULTS / "newest_actor": "results_newest_actor",
    RESULTS / "scale1": "results_scale1",
}
NUMBER = r"([+-]?\d(?:\.\d+)?)"
MADE = re.compile(rf"{NUMBER} \[{NUMBER}, {NUMBER}\]")
QUOTED = re.compile(rf"{NUMBER} \({NUMBER} to {NUMBER}\)")
ROW = re.compile(r"(?<!and )\d\.\d{3}, (?:\d+k|not reached), \d\.\d{3}")
"""Final success, steps to 0.9, area."""
OF_SOME_SEEDS = {(0.111, 0.061, 0.162), (0.114, 0.075, 0.153)}
"""Leads on seeds by which nothing was chosen: of a report of their files alone."""


def values(match: re.Match) -> tuple[float, ...]:
    return tuple(map(float, match.groups()))


@pytest.mark.parametrize("folder", FROM, ids=lambda folder: folder.name)
def test_committed_numbers_are_those_of_the_committed_curves(folder):
    report = page.collect([str(ROOT / "experiments" / FROM[folder])])
    made = numbers.document(report.cells, report.trials)
    assert (folder / numbers.FILE).read_text() == made
    claims = folder / verdicts.FILE
    if claims.exists():
        made = verdicts.document(report.claims, tables.made_of(report.cells))
        assert claims.read_text() == made


def test_what_the_documents_quote_is_there():
    texts = [path.read_text() for path in RESULTS.rglob("*.md")]
    rows = {row for text in texts for row in ROW.findall(text)}
    said = [(path.name, row) for path in PAGES for row in ROW.findall(path.read_text())]
    assert len(said) > 100
    assert not [(name, row) for name, row in said if row not in rows]
    made = {values(m) for text in texts for m in MADE.finditer(text)}
    # The other way round, a lead is what a method is behind.
    made |= {(-value, -high, -low) for value, low, high in made} | OF_SOME_SEEDS
    made |= {values(m) for line in of_engines() for m in MADE.finditer(line)}
    quoted = [(path.name, m) for path in PAGES for m in QUOTED.finditer(path.read_text())]
    assert len(quoted) > 150
    assert not [(name, m[0]) for name, m in quoted if values(m) not in made]


def of_engines() -> list[str]:
    """What the study of engines says of the committed curves."""
    study = runpy.run_path(str(ROOT / "experiments" / "studies" / "engines.py"))
    results = ROOT / "experiments" / "results"
    return study["lines"](results / "early", results / "setting1_warp")


def leads() -> dict[tuple[str, ...], tuple[list[str], list[tuple[float, ...]]]]:
    """(shape, shift, steps) -> seeds and results of CRSfD and SACfD, and their differences."""
    found = {}
    for section in (RESULTS / numbers.FILE).read_text().split("\n## Differences: ")[1:]:
        title, rows = section.split(" steps\n", 1)
        shift, steps = title.lower().split(", ")
        for shape, *sides, differences in re.findall(
            r"^\| (\d) \| CRSfD \| SACfD \| (\d+) \| ([^|]+) \| ([^|]+) \| (.*) \|$", rows, re.M
        ):
            found[shape, shift, steps] = sides, [*map(values, MADE.finditer(differences))]
    return found


@pytest.mark.parametrize(("name", "which"), [("README.md", (0, 2)), ("docs/results.md", (0, 1, 2))])
def test_each_task_stands_beside_its_own_numbers(name, which):
    rows = re.findall(
        r"^\| shape (\d), (.*shift.*?) \| (\d+k), (\d+) \| ([^|]+) \| ([^|]+) \| (.*) \|$",
        (ROOT / name).read_text(),
        re.M,
    )
    made = leads()
    assert len(rows) >= 6
    for shape, shift, steps, *sides, differences in rows:
        expected, all_three = made[shape, shift, steps]
        assert sides == expected, (name, shape, shift)
        said = [*map(values, QUOTED.finditer(differences))]
        assert said == [all_three[i] for i in which], (name, shape, shift)


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "docs" / "results.md"], ids=str)
def test_claims_are_counted_as_they_are_judged(page):
    rows = re.findall(r"^\| (holds|does not hold|undecided) \|", CLAIMS.read_text(), re.M)
    counts = [len(rows), *map(rows.count, ("holds", "does not hold", "undecided"))]
    said = COUNTED.search(page.read_text())
    assert said and [int(number) for number in said.groups()] == counts
