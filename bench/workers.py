"""Environment steps a second of several cells at a time, each on its share of the cores, as JSON.

What `python -m crsfd_jax.sweep --workers N` gains over one cell after the other: the same runs,
which differ in their seeds alone, by one worker and by N. Start-up and compiling do not count.
"""

import dataclasses
import json
import os
import tempfile
from pathlib import Path

import tyro

from crsfd_jax import cli
from crsfd_jax.config import Config
from crsfd_jax.storage import metrics, run_folder
from crsfd_jax.sweeps import local_pool
from crsfd_jax.sweeps.attempt import Plan
from crsfd_jax.sweeps.cells import Cell

STEPS = 20_480
"""Of each seed: enough for the updates, which begin after 2,000, to set the pace."""


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure."""

    workers: int = os.cpu_count() or 1
    """Cells at a time."""


def steps_per_second(workers: int, plan: Plan) -> float:
    """Of all seeds of as many cells as workers, which run side by side."""
    count = Config().seeds
    given = ("--shift", "8mm", "--steps", str(STEPS), "--evaluation.every", str(STEPS))
    todo = [_cell(worker, (*given, "--seed", str(count * worker))) for worker in range(workers)]
    for outcome in local_pool.run([(cell,) for cell in todo], plan, workers, lambda: False):
        if outcome.word != "done":
            raise RuntimeError(f"{outcome.name}: {outcome.word}: {outcome.tail}")
    tables = [metrics.read(run_folder.at(plan.out / cell.name).metrics) for cell in todo]
    return sum(STEPS * count / float(table["time/wall_s"].max()) for table in tables)


def _cell(worker: int, arguments: tuple[str, ...]) -> Cell:
    return Cell(f"worker{worker}", arguments, cli.parse(Config, arguments))


def main(options: Options) -> None:
    """Measures one worker twice, for its first run may compile, and then several."""
    with tempfile.TemporaryDirectory() as scratch:
        rates = [
            steps_per_second(workers, Plan(Path(scratch) / str(turn), retries=0))
            for turn, workers in enumerate((1, 1, options.workers))
        ]
    one, several = rates[1:]
    line = {"bench": "workers", "cores": os.cpu_count(), "workers": options.workers}
    line |= {"one_env_steps_per_second": round(one), "all_env_steps_per_second": round(several)}
    print(json.dumps({**line, "gain": round(several / one, 3)}))


if __name__ == "__main__":
    main(tyro.cli(Options))
