"""`python -m crsfd_jax`: lists the programs of this package."""

import ast
from pathlib import Path

from crsfd_jax import cli
from crsfd_jax.errors import UserError

PROGRAMS = ("train", "evaluate", "view", "export", "report", "sweep", "demos", "doctor")
_FOLDER = Path(__file__).parent


def run(argv: list[str]) -> None:
    """Prints a line for each program.

    Raises:
      UserError: a program is named as if it were a subcommand.
    """
    if argv and argv[0] in PROGRAMS:
        raise UserError(f"{argv[0]}: is a program; write python -m crsfd_jax.{argv[0]}")
    print("python -m crsfd_jax.PROGRAM --help tells the options of each:\n")
    for name in PROGRAMS:
        print(f"  {name:10s}{summary(name)}")


def summary(name: str) -> str:
    """What a program does, from the first line of its module."""
    file = _FOLDER / f"{name}.py"
    text = (file if file.exists() else _FOLDER / name / "__main__.py").read_text(encoding="utf-8")
    first = (ast.get_docstring(ast.parse(text)) or "").splitlines()[0]
    said = first.rpartition("`: ")[2].removesuffix(".")
    return said[:1].upper() + said[1:]


if __name__ == "__main__":
    cli.main(run)
