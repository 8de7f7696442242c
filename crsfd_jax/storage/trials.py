"""Tables of trials: how often the policies of a run inserted, and what they were asked to do."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from crsfd_jax.errors import UserError
from crsfd_jax.storage.files import output, write_text


class Row(NamedTuple):
    """Trials of a seed's policy on a shape."""

    seed: int
    shape: str
    trials: int
    successes: int
    options: str
    """Of `python -m crsfd_jax.evaluate`, besides the run, as `options.trials.read` says."""


def write(path: Path, rows: Sequence[Row], option: str) -> None:
    """Writes a table that an option names.

    Raises:
      UserError: it cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([Row._fields, *rows])
    with output(path, option):
        write_text(path, text.getvalue())


def read(path: Path) -> list[Row]:
    """The rows of a table that have trials, none in a table of another kind.

    Raises:
      UserError: it is damaged, or not there.
    """
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            lines = csv.DictReader(stream)
            if "successes" not in (lines.fieldnames or ()):
                return []
            rows = [_row(**line) for line in lines]
    except (OSError, TypeError, ValueError, csv.Error) as error:
        raise UserError(f"{path}: not a table of trials: {error}") from error
    for row in rows:
        if not 0 <= row.successes <= row.trials:
            raise UserError(f"{path}: seed {row.seed} has {row.successes} of {row.trials} trials")
    return [row for row in rows if row.trials]


def _row(seed: str, shape: str, trials: str, successes: str, options: str) -> Row:
    return Row(int(seed), shape, int(trials), int(successes), options)
