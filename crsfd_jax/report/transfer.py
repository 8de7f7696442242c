"""Trials of trained policies under conditions that training never saw, from CSV files."""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from crsfd_jax.errors import UserError
from crsfd_jax.options.randomisation import Randomisation
from crsfd_jax.report.methods import rank, style
from crsfd_jax.storage import manifest, run_folder

COLUMNS = ("shape", "trials", "successes")
"""What the first line of such a file names, as evaluate --csv writes it, among other columns."""
_WORDS = ("transfer", "held_out")


class Transfer(NamedTuple):
    """All trials of the policies of one method on one shape."""

    method: str
    randomised: bool
    """Whether the policies were trained under randomisation."""
    shape: str
    successes: int
    trials: int

    @property
    def label(self) -> str:
        """Method and training in words."""
        return f"{style(self.method).label}{'' if self.randomised else ', no randomisation'}"


def find(roots: Sequence[str | Path]) -> tuple[list[Transfer], list[str]]:
    """Adds up the trials on each shape in the tables in and below folders.

    Such a table, or a folder around it, has transfer or held_out in its name. It belongs to the
    run in whose folder it lies, or to the NAME.json that its name begins with; without either it
    is taken for CRSfD trained under randomisation. Of several tables of a run, that with the most
    trials counts.

    Returns:
      Trials by method and shape, and a line for each file that cannot be used.
    """
    largest: dict[tuple, Transfer] = {}
    skipped = []
    for path in sorted({path for root in roots for path in tables(Path(root))}):
        try:
            config = config_of(path)
            method, randomised = _training(config) if config else ("crsfd", True)
            for shape, counts in totals(path).items():
                each = Transfer(method, randomised, shape, *counts)
                place = (config or path.parent, each.method, each.shape)
                largest[place] = max(each, largest.get(place, each), key=lambda t: t.trials)
        except UserError as error:
            skipped.append(str(error))
    summed: dict[tuple, Transfer] = {}
    for each in largest.values():
        other = summed.get(each[:3], each._replace(successes=0, trials=0))
        counts = each.successes + other.successes, each.trials + other.trials
        summed[each[:3]] = Transfer(*each[:3], *counts)
    return sorted(summed.values(), key=_place), skipped


def _place(transfer: Transfer) -> tuple:
    return (not transfer.randomised, rank(transfer.method), transfer.shape)


def tables(root: Path) -> Iterator[Path]:
    """Tables in and below a folder that are, by their names, of held-out trials."""
    for path in root.rglob("*.csv"):
        inner = str(Path(root.resolve().name) / path.relative_to(root)).lower()
        if any(word in inner for word in _WORDS):
            yield path


def config_of(path: Path) -> Path | None:
    """The file that describes the run of a table."""
    described = [file for file in path.parent.glob("*.json") if path.stem.startswith(file.stem)]
    described += [file for file in [run_folder.at(path.parent).config] if file.exists()]
    return max(described, key=lambda file: len(file.stem), default=None)


def totals(path: Path) -> dict[str, tuple[int, int]]:
    """Successes and trials of each shape in a file; none in a table of another kind.

    Raises:
      UserError: it is damaged.
    """
    counted: dict[str, tuple[int, int]] = {}
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            lines = csv.DictReader(stream)
            if not set(COLUMNS) <= set(lines.fieldnames or ()):
                return {}
            for line in lines:
                successes, trials = counted.get(line["shape"], (0, 0))
                successes, trials = successes + int(line["successes"]), trials + int(line["trials"])
                counted[line["shape"]] = successes, trials
    except (OSError, TypeError, ValueError, csv.Error) as error:
        raise UserError(f"{path}: not a table of trials: {error}") from error
    for shape, (successes, trials) in counted.items():
        if not 0 <= successes <= trials:
            raise UserError(f"{path}: shape {shape} has {successes} successes in {trials} trials")
    return {shape: counts for shape, counts in counted.items() if counts[1]}


def _training(described: Path) -> tuple[str, bool]:
    """The method of a run, and whether it was randomised."""
    config = manifest.read(described).config
    return config.algorithm, config.randomisation != Randomisation()
