"""Do the same runs learn the same on another engine, or another machine?

Hypothesis: engines agree to float32 for some steps and then drift apart as seeds do, so that means
over seeds differ by no more than chance.

    python experiments/studies/engines.py \\
        experiments/results/early experiments/results/setting1_warp

For each method that both folders have: how much larger its area is in the first, over the steps,
seeds and tasks in common, and the same while exploring. What came out is in
docs/clusters_and_gpus.md.
"""

from dataclasses import dataclass
from pathlib import Path

import tyro

from crsfd_jax import cli
from crsfd_jax.errors import UserError
from crsfd_jax.report import cells, pairing, runs, summary
from crsfd_jax.report.evidence import show
from crsfd_jax.report.methods import rank, style


@dataclass(frozen=True)
class Engines:
    """Sets runs beside runs of other engines or machines, method by method."""

    first: tyro.conf.Positional[Path]
    """Folder with runs."""
    second: tyro.conf.Positional[Path]
    """Folder with runs of the same methods, tasks and seeds."""


def lines(first: Path, second: Path) -> list[str]:
    """One for each method.

    Raises:
      UserError: the folders have no method and task in common.
    """
    one, other = (pairing.index(cells.gather(runs.find([f]).runs)[0]) for f in (first, second))
    shared: dict[str, list[tuple[cells.Cell, cells.Cell]]] = {}
    for method, task in (key for key in one if key in other):
        shared.setdefault(method, []).append((one[method, task][0], other[method, task][0]))
    if not shared:
        raise UserError(f"{second}: has no method and task of {first}; choose another")
    found = {method: summary.compare(shared[method]) for method in sorted(shared, key=rank)}
    return [
        f"{style(method).label}: area {show(each.area)}, exploring {show(each.exploring)}; "
        f"{each.tasks} tasks, {max(each.steps):,} steps"
        for method, each in found.items()
        if each and each.exploring
    ]


def main(argv: list[str]) -> None:
    """Prints a line for each method."""
    options = cli.parse(Engines, argv)
    print("\n".join(lines(options.first, options.second)))


if __name__ == "__main__":
    cli.main(main)
