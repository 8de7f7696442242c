"""The report: one web page with everything in it, and its figures as PNG beside it."""

import datetime
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from crsfd_jax.errors import UserError
from crsfd_jax.report import cells as grouping
from crsfd_jax.report import (
    claims,
    figures,
    gaps,
    headline,
    html,
    layout,
    leads,
    numbers,
    runs,
    tables,
    trial_sections,
    trials,
    verdicts,
)
from crsfd_jax.report.cells import Cell
from crsfd_jax.report.evidence import Claim
from crsfd_jax.report.layout import Figure
from crsfd_jax.report.methods import style
from crsfd_jax.report.summary import LEVEL
from crsfd_jax.report.trials import Trials
from crsfd_jax.storage import run_folder
from crsfd_jax.storage.files import output, write_text

FILE = "report.html"
MAX_FILM_BYTES = 16 * 2**20
"""Of all films in a page."""
_TITLE = "Insertion from demonstrations of another task"
_NOTES = (
    "Success is that of the deterministic policy in fresh evaluation episodes.",
    "Final success of a seed: mean of its evaluations in the last tenth of its steps. Mean ± "
    "standard deviation (population) over seeds, as the figures draw it.",
    "Intervals of differences are Student's t over seeds. Those of IQM (mean of the middle half of "
    "the seeds) and P(better) are bootstrapped (10,000 samples of the seeds, percentiles 2.5 and "
    "97.5), somewhat too narrow with few seeds. On several tasks a seed counts once. No interval "
    "makes up for several comparisons, or for seeds that were added because fewer left the order "
    "open.",
    f"Steps to {LEVEL * 100:g} %: first of three evaluations in a row at which the mean over seeds "
    f"is {LEVEL:g} or more; seeds there: how many have three such evaluations themselves.",
    "Area: under the curve of success from 0 steps (success 0) to the last, divided by the steps; "
    "1 would be success from the start. Differences pair seeds of the same number, or, where two "
    "runs have only some in common, in their order. While "
    "exploring: the same of the episodes of training, in which the policy is sampled.",
    "P(better): chance that a seed of the one scores above a seed of the other on the same task, "
    "ties count half (Mann and Whitney), mean over tasks.",
    "Seeds that diverged are in all averages, with the success that they had; the troubles of each "
    "run are listed with the machines.",
    "BC does not interact: it has one level, that of its last evaluations.",
)


class Report(NamedTuple):
    """All that the page tells."""

    cells: list[Cell]
    figures: list[Figure]
    claims: list[Claim]
    trials: list[Trials]
    skipped: list[str]


def collect(roots: Sequence[str]) -> Report:
    """Reads runs and works out what there is to say.

    Raises:
      UserError: there is no run.
    """
    found = runs.find(roots)
    cells, repeated = grouping.gather(found.runs)
    played, unusable = trials.find(roots, cells)
    return Report(
        cells=cells,
        figures=layout.figures(cells),
        claims=claims.judge(cells, played),
        trials=played,
        skipped=[*found.skipped, *repeated, *unusable],
    )


def write(report: Report, folder: Path, value_map: Callable[[Path], str]) -> Path:
    """Writes the page and its figures into a folder.

    Args:
      value_map: draws the potential into a file and returns what to say below it.

    Raises:
      UserError: the folder cannot be written.
    """
    films = _films(report.cells)
    with output(folder):
        folder.mkdir(parents=True, exist_ok=True)
        pictures = [_picture(figure, folder) for figure in report.figures]
        body = [
            *_top(report),
            html.section("Success against environment steps", *pictures),
            _results(report.cells),
            _comparisons(report, folder),
            verdicts.section(report.claims),
            trial_sections.held_out([t for t in report.trials if t.held_out], folder),
            trial_sections.own([t for t in report.trials if not t.held_out]),
            _potential(folder, value_map),
            films,
            _origin(report),
            _gaps(report),
            html.section("How the numbers are made", html.bullets(_NOTES)),
        ]
        text = html.page(_TITLE, [part for part in body if part])
        write_text(folder / FILE, text)
        made_of = tables.made_of(report.cells)
        write_text(folder / verdicts.FILE, verdicts.document(report.claims, made_of))
        write_text(folder / numbers.FILE, numbers.document(report.cells, report.trials))
    return folder / FILE


def _top(report: Report) -> list[str]:
    made = datetime.date.today().isoformat()
    count = sum(len(cell.runs) for cell in report.cells)
    said = " ".join(headline.sentences(report.cells, report.claims))
    return [
        f"<h1>{_TITLE}</h1>",
        html.paragraph(said, "lead"),
        html.paragraph(f"{count} runs, report of {made}.", "quiet"),
    ]


def _results(cells: Sequence[Cell]) -> str:
    """Folds away what has other options, of which studies have more than a page."""
    usual = tables.results([cell for cell in cells if not cell.variant])
    others = tables.results([cell for cell in cells if cell.variant])
    parts = [html.table(*usual)] if usual.rows else []
    if others.rows:
        parts.append(html.folded("with other options", html.table(*others)))
    return html.section("Results", *parts)


def _picture(figure: Figure, folder: Path) -> str:
    path = folder / f"{figure.name}.png"
    figures.draw(figure, path)
    text = f"{figure.caption}. Line: mean over seeds, band: one standard deviation."
    return html.media(path, text)


def _comparisons(report: Report, folder: Path) -> str:
    ours = headline.subject(report.cells)
    over_all, each = tables.comparisons(report.cells, ours)
    if not over_all.rows:
        return ""
    label = style(ours).label
    return html.section(
        f"{label} against each method",
        html.paragraph(f"Positive, or a chance above one half: {label} is ahead."),
        html.table(*over_all),
        html.folded("task by task", html.table(*each)),
        _leads(report.cells, folder),
    )


def _leads(cells: Sequence[Cell], folder: Path) -> str:
    found, path = leads.find(cells), folder / "leads.png"
    if len(found) < 2:
        return ""
    leads.draw(found, path)
    return html.media(path, leads.CAPTION)


def _potential(folder: Path, value_map: Callable[[Path], str]) -> str:
    path = folder / "value_map.png"
    try:
        caption = value_map(path)
    except UserError as error:
        return html.section("Potential", html.paragraph(f"Not drawn: {error}", "quiet"))
    return html.section("Potential", html.media(path, caption))


def _films(cells: Sequence[Cell]) -> str:
    found = [(cell, path) for cell in cells for run in cell.runs for path in run.films]
    shown, large, left = [], [], MAX_FILM_BYTES
    for cell, path in found:
        size = path.stat().st_size
        if size > left:
            large.append(f"{path}: no room for it in this page")
            continue
        left -= size
        is_clip = path.parent == run_folder.at(path.parent.parent).clips and path.stem.isdecimal()
        age = f", {int(path.stem):,} steps" if is_clip else ""
        shown.append(html.media(path, f"{cell.task}: {tables.name(cell)}{age}"))
    if not found:
        return ""
    films = f'<div class="clips">{"".join(shown)}</div>'
    return html.section("Policies at work", films, html.bullets(large) if large else "")


def _origin(report: Report) -> str:
    parts = [html.table(*tables.machines(report.cells))]
    options = tables.options(report.cells)
    if options.rows:
        parts += [html.paragraph("Options that are not at their default:"), html.table(*options)]
    runs_of = [run for cell in report.cells for run in cell.runs]
    troubles = [f"{run.name}: {line}" for run in runs_of for line in run.troubles]
    if troubles:
        parts.append(html.folded("troubles of seeds and simulations", html.bullets(troubles)))
    return html.section("Machines, versions and options", *parts)


def _gaps(report: Report) -> str:
    lines = [*gaps.lines(report.cells, report.figures)]
    lines += [f"left out: {line}" for line in report.skipped]
    shown = html.bullets(lines) if lines else html.paragraph("Nothing is missing.")
    return html.section("Unfinished, missing, left out", shown)
