"""Copies metrics, options and trials of runs to experiments/results/, for the report.

python experiments/collect.py runs/setting2 runs/setting1/CELL
python -m crsfd_jax.report experiments/results --out docs/results
"""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import tyro

from crsfd_jax import cli
from crsfd_jax.errors import UserError
from crsfd_jax.sweeps.state import TRIALS

RESULTS = Path(__file__).parent / "results"
PRIVATE = ("out", "demos")
"""Options that may hold a path of the machine."""


def collect(run: Path) -> Path:
    """Copies one run folder's tables and config.json under its experiment's name and its own."""
    manifest = json.loads((run / "config.json").read_text())
    del manifest["command"]
    for option in PRIVATE:
        manifest["config"][option] = Path(manifest["config"][option]).name
    folder = RESULTS / run.resolve().parent.name
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(run / "metrics.csv", folder / f"{run.name}.csv")
    if (run / TRIALS).exists():
        shutil.copyfile(run / TRIALS, folder / f"{run.name}-{TRIALS}")
    (folder / f"{run.name}.json").write_text(json.dumps(manifest, indent=1) + "\n")
    return folder / f"{run.name}.csv"


@dataclass(frozen=True)
class Collect:
    """Copies the tables and options of runs to experiments/results/."""

    folder: tyro.conf.Positional[Path]
    """Folder of a run, or with runs in it."""
    others: tyro.conf.Positional[tuple[Path, ...]] = ()
    """More of them."""


def main(argv: list[str]) -> None:
    """Collects every run in and below the folders.

    Raises:
      UserError: a folder holds none.
    """
    options = cli.parse(Collect, argv)
    for folder in (options.folder, *options.others):
        found = sorted(folder.rglob("config.json"))
        if not found:
            raise UserError(f"{folder}: no run in it; give the folder of a run or one with runs")
        for config in found:
            print(collect(config.parent))


if __name__ == "__main__":
    cli.main(main)
