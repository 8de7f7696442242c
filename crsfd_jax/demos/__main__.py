"""`python -m crsfd_jax.demos record|info|check`: make and inspect demonstration files."""

import dataclasses
from typing import Annotated

import tyro

from crsfd_jax import cli, config


@dataclasses.dataclass(frozen=True)
class Info:
    """Tells what a demonstration file holds and where it comes from."""

    file: tyro.conf.Positional[str] = "builtin"
    """The file, or builtin for the shipped demonstrations."""


@dataclasses.dataclass(frozen=True)
class Check:
    """Replays a demonstration file in the simulator and reports success."""

    file: tyro.conf.Positional[str] = "builtin"
    """The file, or builtin for the shipped demonstrations."""


Command = (
    Annotated[config.Record, tyro.conf.subcommand("record")]
    | Annotated[Info, tyro.conf.subcommand("info")]
    | Annotated[Check, tyro.conf.subcommand("check")]
)


def run(argv: list[str]) -> int:
    """Runs a subcommand; exit code 1 if a replay contradicts its file."""
    command = cli.parse(Command, argv)  # pyright: ignore[reportArgumentType]
    from crsfd_jax.demos import commands

    if isinstance(command, config.Record):
        return commands.record_file(command, " ".join(["python -m crsfd_jax.demos", *argv]))
    if isinstance(command, Info):
        return commands.show(command.file)
    return commands.check(command.file)


if __name__ == "__main__":
    cli.main(run)
