"""Copies metrics and options of runs to experiments/results/, which `crsfd_jax.report` can read.

python experiments/collect.py runs/setting2 runs/setting1/CELL
python -m crsfd_jax.report experiments/results --out docs/results
"""

import json
import shutil
import sys
from pathlib import Path

RESULTS = Path(__file__).parent / "results"
PRIVATE = ("out", "demos")
"""Options that may hold a path of the machine."""


def collect(run: Path) -> Path:
    """Copies one run folder's metrics.csv and config.json under the folder's name."""
    manifest = json.loads((run / "config.json").read_text())
    del manifest["command"]
    for option in PRIVATE:
        manifest["config"][option] = Path(manifest["config"][option]).name
    RESULTS.mkdir(exist_ok=True)
    shutil.copyfile(run / "metrics.csv", RESULTS / f"{run.name}.csv")
    (RESULTS / f"{run.name}.json").write_text(json.dumps(manifest, indent=1) + "\n")
    return RESULTS / f"{run.name}.csv"


def main(folders: list[str]) -> None:
    """Collects every run in and below the folders."""
    for folder in folders:
        for config in sorted(Path(folder).rglob("config.json")):
            print(collect(config.parent))


if __name__ == "__main__":
    main(sys.argv[1:])
