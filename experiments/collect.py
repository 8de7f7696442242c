"""Copies metrics, options and trials of runs to experiments/results/, for the report.

python experiments/collect.py runs/setting2 runs/setting1/CELL
python -m crsfd_jax.report experiments/results --out docs/results
"""

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from crsfd_jax import cli
from crsfd_jax.errors import UserError
from crsfd_jax.storage import manifest, run_folder
from crsfd_jax.storage.run_folder import RunFolder

RESULTS = Path(__file__).parent / "results"


def collect(run: RunFolder) -> Path:
    """Copies a run's tables and config.json under its experiment's name and its own."""
    told, path = manifest.read(run.config), run.path.resolve()
    if not run.metrics.exists():
        raise UserError(f"{run.path}: has no evaluation yet; collect it later")
    folder, name = RESULTS / path.parent.name, path.name
    folder.mkdir(parents=True, exist_ok=True)
    # What may hold a path of this machine.
    config = replace(
        told.config, out=Path(told.config.out).name, demos=Path(told.config.demos).name
    )
    manifest.write(folder / f"{name}.json", told._replace(config=config, command=()))
    shutil.copyfile(run.metrics, folder / f"{name}.csv")
    trials = folder / f"{name}-{run.trials.name}"
    if run.trials.exists():
        shutil.copyfile(run.trials, trials)
    else:
        trials.unlink(missing_ok=True)  # Those of a policy that this run no longer has.
    return folder / f"{name}.csv"


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
            try:
                print(collect(run_folder.at(config.parent)))
            except UserError as error:
                print(f"left out  {error}")


if __name__ == "__main__":
    cli.main(main)
