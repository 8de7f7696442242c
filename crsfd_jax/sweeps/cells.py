"""An experiment: what it asks, and its cells, each a run with a name of its own."""

import re
import runpy
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from crsfd_jax import artefacts, cli
from crsfd_jax.config import Config, run_name, to_dict
from crsfd_jax.errors import UserError
from crsfd_jax.limits import choice_message
from crsfd_jax.option_names import by_full_name
from crsfd_jax.randomisation import TRAINING
from crsfd_jax.smoke import smoke_sized

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
_NOT_IN_NAME = ("steps", "evaluation.every", "evaluation.episodes", *artefacts.MAY_CHANGE)
"""How far a run goes and how closely it is looked at: it is the same run."""
_IN_RUN_NAME = ("algorithm", "shape", "shift", "seed", "seeds", "smoke")


class Cell(NamedTuple):
    """One run of an experiment."""

    name: str
    """Made of the options, so the same in every experiment that has this run."""
    arguments: tuple[str, ...]
    """What `python -m crsfd_jax.train` is called with, besides --out."""
    config: Config
    """What the arguments mean."""
    trials: tuple[str, ...] = ()
    """What `python -m crsfd_jax.evaluate` is called with once it is trained; empty for nothing."""


class Experiment(NamedTuple):
    """A file of the folder experiments/."""

    name: str
    description: str
    cells: tuple[Cell, ...]
    demos: Mapping[str, tuple[str, ...]]
    """Files of demonstrations, and what `python -m crsfd_jax.demos` is called with to make each."""


def load(name: str) -> Experiment:
    """Reads an experiment by its name or by the path of its .py file, which is executed.

    A file holds `CELLS`, a tuple of tuples of arguments; its docstring's first line describes it.
    It may hold `DEMOS` and `TRIALS` as well: see `Experiment.demos` and `Cell.trials`.

    Raises:
      UserError: there is none, it holds no cells, two cells are the same run, or a cell is
        no command line of a run.
    """
    path = Path(name) if name.endswith(".py") else EXPERIMENTS / f"{name}.py"
    if not path.is_file():
        if name.endswith(".py"):
            raise UserError(f"--experiment: got {name!r}, which does not exist; check the name")
        known = ("FILE.py", *(entry.stem for entry in available()))
        raise UserError(choice_message("--experiment", name, known))
    try:
        found = runpy.run_path(str(path))
    except Exception as error:
        # The file is the user's: anything may be wrong in it.
        raise UserError(f"{path}: {type(error).__name__}: {error}; correct the file") from error
    if not found.get("CELLS"):
        raise UserError(f"{path}: defines no CELLS, expected a tuple of argument tuples; add it")
    trials = tuple(found.get("TRIALS", ()))
    cells = tuple(_cell(path, number, given, trials) for number, given in enumerate(found["CELLS"]))
    twice = [name for name, count in Counter(cell.name for cell in cells).items() if count > 1]
    if twice:
        raise UserError(f"{path}: cell {twice[0]} is there more than once; keep one of them")
    description = (found["__doc__"] or path.stem).strip().splitlines()[0]
    return Experiment(path.stem, description, cells, found.get("DEMOS", {}))


def available() -> list[Path]:
    """The files of experiments/ that hold cells."""
    files = sorted(EXPERIMENTS.glob("*.py"))
    return [path for path in files if re.search(r"^CELLS = ", path.read_text(), re.MULTILINE)]


def cell_name(config: Config) -> str:
    """The name of a run, with every option that differs from its default."""
    options = by_full_name(to_dict(config))
    if config.randomisation == TRAINING:
        # run_name says that it is randomised, and these are the usual ranges.
        options = {name: options[name] for name in options if not name.startswith("randomisation.")}
    extra = [
        f"-{option}{_show(value)}"
        for option, value in options.items()
        if option not in (*_NOT_IN_NAME, *_IN_RUN_NAME) and value != _DEFAULTS[option]
    ]
    return re.sub(r"[^\w.+-]+", "_", "".join([run_name(config), *extra]))


def _cell(path: Path, number: int, given: Any, trials: tuple[str, ...]) -> Cell:
    try:
        arguments = tuple(map(str, given))
        config = cli.parse(Config, arguments)
    except UserError as error:
        raise UserError(f"{path}: cell {number}: {error}") from error
    if config.out:
        raise UserError(f"{path}: cell {number}: --out: got {config.out!r}, allowed: none; drop it")
    # Named before it is shrunk: --smoke alone says so.
    shrunk = smoke_sized(config) if config.smoke else config
    return Cell(cell_name(config), arguments, shrunk, trials)


def _show(value: Any) -> str:
    if isinstance(value, tuple):
        return "x".join(map(_show, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


_DEFAULTS = by_full_name(to_dict(Config()))
