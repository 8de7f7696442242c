"""Trials of trained policies under conditions that training never saw, from CSV files."""

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from crsfd_jax.config import Config, to_dict
from crsfd_jax.errors import UserError
from crsfd_jax.report.methods import rank, style

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
    for path in sorted({path for root in roots for path in _tables(Path(root))}):
        try:
            config = _config_of(path)
            for each in _totals(path, _read(config) if config else None):
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


def _tables(root: Path) -> Iterator[Path]:
    for path in root.rglob("*.csv"):
        inner = str(Path(root.resolve().name) / path.relative_to(root)).lower()
        if any(word in inner for word in _WORDS):
            yield path


def _config_of(path: Path) -> Path | None:
    """The file that describes the run of a table."""
    described = [file for file in path.parent.glob("*.json") if path.stem.startswith(file.stem)]
    described += [file for file in [path.parent / "config.json"] if file.exists()]
    return max(described, key=lambda file: len(file.stem), default=None)


def _read(path: Path) -> dict[str, Any]:
    try:
        config = json.loads(path.read_bytes())["config"]
        return {"algorithm": str(config["algorithm"]), "drawn": dict(config["randomisation"])}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path}: is not the description of a run") from error


def _totals(path: Path, run: dict[str, Any] | None) -> list[Transfer]:
    """Trials of each shape in a file; none in a table of another kind.

    Raises:
      UserError: it is damaged.
    """
    totals: dict[str, list[int]] = {}
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            lines = csv.DictReader(stream)
            if not set(COLUMNS) <= set(lines.fieldnames or ()):
                return []
            for line in lines:
                counts = totals.setdefault(line["shape"], [0, 0])
                counts[0] += int(line["successes"])
                counts[1] += int(line["trials"])
    except (OSError, TypeError, ValueError, csv.Error) as error:
        raise UserError(f"{path}: not a table of trials: {error}") from error
    for shape, (successes, trials) in totals.items():
        if not 0 <= successes <= trials:
            raise UserError(f"{path}: shape {shape} has {successes} successes in {trials} trials")
    plain = json.loads(json.dumps(to_dict(Config())["randomisation"]))
    method, randomised = (run["algorithm"], run["drawn"] != plain) if run else ("crsfd", True)
    return [Transfer(method, randomised, shape, *n) for shape, n in totals.items() if n[1]]
