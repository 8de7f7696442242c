"""`python -m crsfd_jax.demos COMMAND`: record, inspect, check and exchange demonstrations."""

import dataclasses
from typing import Annotated, Literal

import tyro

from crsfd_jax import cli
from crsfd_jax.demos.options import FromRun, Record


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


@dataclasses.dataclass(frozen=True)
class Import:
    """Turns demonstrations of another format into a demonstration file."""

    source: tyro.conf.Positional[str]
    """An HDF5 file in the layout of robomimic, or minari:NAME."""
    out: str = "imported.npz"
    """File to write; an existing one is not overwritten."""


@dataclasses.dataclass(frozen=True)
class Export:
    """Writes a demonstration file in the format of another tool."""

    file: tyro.conf.Positional[str] = "builtin"
    """The file, or builtin for the shipped demonstrations."""
    format: Literal["robomimic", "minari"] = "robomimic"
    """An HDF5 file in the layout of robomimic, or a data set in Minari's local store."""
    out: str = ""
    """File to write, or name of the data set; demos.hdf5 or crsfd/demos-v0 if not given."""


Command = (
    Annotated[Record, tyro.conf.subcommand("record")]
    | Annotated[FromRun, tyro.conf.subcommand("from-run")]
    | Annotated[Info, tyro.conf.subcommand("info")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Import, tyro.conf.subcommand("import")]
    | Annotated[Export, tyro.conf.subcommand("export")]
)


def run(argv: list[str]) -> int:
    """Runs a subcommand; exit code 1 if a replay contradicts its file."""
    command = cli.parse(Command, argv)  # pyright: ignore[reportArgumentType]
    from crsfd_jax.demos import commands

    line = " ".join(["python -m crsfd_jax.demos", *argv])
    if isinstance(command, Record):
        return commands.record_file(command, line)
    if isinstance(command, FromRun):
        return commands.record_run(command, line)
    if isinstance(command, Info):
        return commands.show(command.file)
    if isinstance(command, Import):
        return commands.import_demos(command.source, command.out)
    if isinstance(command, Export):
        return commands.export_demos(command.file, command.format, command.out)
    return commands.check(command.file)


if __name__ == "__main__":
    cli.main(run)
