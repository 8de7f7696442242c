"""Runs that differ in task and seeds alone: one program can compute all of them side by side."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from crsfd_jax.config import Config
from crsfd_jax.errors import UserError
from crsfd_jax.options import shapes
from crsfd_jax.options.limits import differences
from crsfd_jax.options.names import MAY_CHANGE
from crsfd_jax.options.run_name import default_folder

MARK = "--and"
"""Between the command lines of two runs."""
OWN = ("shape", "shift", "seed", "seeds", *(n for n in MAY_CHANGE if n != "engine"))
"""Options that each of them may give a value of its own."""


def likeness(config: Config) -> tuple[int, Config]:
    """Equal for runs that can share a program: their arrays have the same shapes.

    As many shapes are drawn for the episodes of each, and all options but `OWN` are the same.
    """
    blank = {name: getattr(Config(), name) for name in OWN}
    return len(shapes.read(config.shape)), dataclasses.replace(config, **blank)


def command_lines(argv: Sequence[str]) -> list[list[str]]:
    """The command line of each run; only one where `MARK` is not given.

    Raises:
      UserError: there is nothing on one side of it.
    """
    lines: list[list[str]] = [[]]
    for word in argv:
        if word == MARK:
            lines.append([])
        else:
            lines[-1].append(word)
    if len(lines) > 1 and [] in lines:
        raise UserError(f"{MARK}: got no option on one side, allowed: a command line on either")
    return lines


def require_alike(configs: Sequence[Config]) -> None:
    """Checks that the runs can share a program and have a folder each.

    Raises:
      UserError: the first option that differs and may not, or a folder that two have.
    """
    first, free = configs[0], ", ".join(f"--{name}" for name in OWN)
    folders = [Path(default_folder(config)).absolute() for config in configs]
    for folder in folders:
        if folders.count(folder) > 1:
            raise UserError(f"--out: got {folder} twice, allowed: a folder for each run")
    for config in configs[1:]:
        if likeness(config) == likeness(first):
            continue
        for name, (one, other) in differences(first, config).items():
            if name not in OWN:
                # Whoever did not give them has two numbers of steps with and without a shift.
                free += " (auto goes by the shift)" if name == "steps" else ""
                raise UserError(
                    f"--{name.replace('_', '-')}: got {one} and {other}, allowed to "
                    f"differ beside {MARK}: {free}; give both the same or train the runs apart"
                )
        raise UserError(
            f"--shape: got {first.shape} and {config.shape}, allowed beside {MARK}: as many shapes "
            "on either side; train the runs apart"
        )
