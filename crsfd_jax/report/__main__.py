"""`python -m crsfd_jax.report RUNS`: one web page about runs, and the figures of the paper."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from crsfd_jax import cli


@dataclass(frozen=True)
class Report:
    """Writes report.html and its figures from runs, finished or not."""

    runs: tyro.conf.Positional[tuple[str, ...]]
    """Folders of runs, folders with such folders, or with NAME.csv beside NAME.json."""
    out: str = ""
    """Folder to write into; the folder report in the first of the runs if not given."""


def run(argv: list[str]) -> int:
    """Reports as the command line says; see --help."""
    options = cli.parse(Report, argv)
    # matplotlib takes a second to import: a bad command line is answered before.
    from crsfd_jax.report import page

    report = page.collect(options.runs)
    for line in report.skipped:
        print(f"left out  {line}")

    def value_map(path: Path) -> str:
        # Fits the potential: nothing else here needs jax and mujoco.
        from crsfd_jax import compile_cache
        from crsfd_jax.report import value_map

        compile_cache.enable()
        return value_map.draw_of(report.cells, path)

    folder = Path(options.out or Path(options.runs[0]) / "report")
    print(f"written   {page.write(report, folder, value_map)}")
    return 0


if __name__ == "__main__":
    cli.main(run)
