"""`python -m crsfd_jax.doctor`: what this machine can do and what is missing on it."""

import json
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from crsfd_jax import cli
from crsfd_jax.options.limits import Interval

_WIDTH = 400


@dataclass(frozen=True)
class Doctor:
    """Reports versions, devices, OpenGL, the compile cache, engine speed and missing extras."""

    engines: tuple[Literal["native", "mjx", "warp"], ...] = ()
    """Engines to measure; the one that auto stands for here if none is given. Compiling mjx takes
    most of a minute on a CPU."""
    seconds: Annotated[float, Interval(0, 600)] = 3.0
    """Time to measure an engine for, once compiled."""
    json: bool = False
    """Print one line of JSON instead of a table."""


def main(argv: list[str]) -> None:
    """Prints the report that a command line asks for."""
    options = cli.parse(Doctor, argv)
    from crsfd_jax import checkup

    report = checkup.examine(options.engines, options.seconds)
    if options.json:
        print(json.dumps(report))
    else:
        _show(report)


def _show(report: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None, pad_edge=False, padding=(0, 2))
    for topic, lines in _sections(report):
        for number, line in enumerate(lines):
            table.add_row("" if number else f"[bold]{topic}[/bold]", Text(line, no_wrap=True))
    # Wide enough that no command is broken in two: it is there to be copied.
    Console(width=_WIDTH).print(table, crop=False)


def _sections(report: dict[str, Any]) -> list[tuple[str, list[str]]]:
    versions = [f"{name} {version}" for name, version in report["versions"].items()]
    cache, opengl = report["compile_cache"], report["opengl"]
    picture = f"{opengl['platform']}, draws" if opengl["works"] else opengl["problem"]
    rates = [
        f"{rate['engine']}: {rate['steps_per_s']:,.0f} steps/s with {rate['seeds']} seeds x "
        f"{rate['envs']} envs"
        for rate in report["engines"]
    ] + [f"{name}: {problem}" for name, problem in report["engine_problems"].items()]
    missing = [
        f"{extra}: lacks {', '.join(found['missing'])}; {found['install']}"
        for extra, found in report["extras"].items()
        if found["missing"]
    ]
    complete = [extra for extra, found in report["extras"].items() if not found["missing"]]
    return [
        ("versions", [", ".join(versions[i : i + 5]) for i in range(0, len(versions), 5)]),
        ("devices", [*report["devices"], f"{report['cores']} cores"]),
        ("OpenGL", [picture]),
        ("compile cache", [f"{cache['folder']}, {cache['bytes'] / 1e6:,.0f} MB"]),
        ("speed", rates),
        ("suggested", [f"--engine {report['engine']} --envs {report['suggested_envs']}"]),
        ("extras here", [", ".join(complete) or "none"]),
        ("extras missing", missing or ["none"]),
    ]


if __name__ == "__main__":
    cli.main(main)
