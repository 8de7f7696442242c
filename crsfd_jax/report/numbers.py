"""All numbers of the report as a document of Markdown, to read and to quote from."""

from collections.abc import Iterator, Sequence

from crsfd_jax.report import differences, markdown, tables
from crsfd_jax.report.cells import Cell
from crsfd_jax.report.summary import LEVEL
from crsfd_jax.report.tables import Table
from crsfd_jax.report.trials import Trials

FILE = "numbers.md"
_WORDS = (
    "final: mean success over the evaluations of the last tenth of the steps",
    f"at {LEVEL:g}: steps at the first of three evaluations in a row at which the mean over the "
    f"seeds is {LEVEL:g} or more",
    "area: under the curve of success, over the steps",
    "exploring: the same of the episodes of training, warm-up included",
    "differences: first minus second, with the 95 % interval, Student's t over the seeds that both "
    "have (where each has some that the other lacks, paired in their order); positive where the "
    "first is ahead",
)


def document(cells: Sequence[Cell], trials: Sequence[Trials]) -> str:
    """Every cell, the differences between any two, and trials.

    Args:
      trials: of policies of these cells.
    """
    return markdown.document(
        "Numbers",
        markdown.bullets(_WORDS),
        *(part for title, table in _tables(cells, trials) for part in _shown(title, table)),
    )


def _tables(cells: Sequence[Cell], trials: Sequence[Trials]) -> Iterator[tuple[str, Table]]:
    yield "Each method on each task", tables.results(cells)
    for title, table in differences.find(cells):
        yield f"Differences: {title}", table
    yield "Trials held out from training", tables.transfers([t for t in trials if t.held_out])
    yield "Trials on the task of training", tables.own_trials([t for t in trials if not t.held_out])


def _shown(title: str, table: Table) -> list[str]:
    return [f"## {title}", markdown.table(table.head, table.rows)] if table.rows else []
