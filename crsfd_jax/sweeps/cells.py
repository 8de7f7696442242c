"""An experiment: what it asks, and its cells, each a run with a name of its own."""

import re
import runpy
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from crsfd_jax import cli
from crsfd_jax.config import Config
from crsfd_jax.errors import UserError
from crsfd_jax.options.limits import choice_message
from crsfd_jax.options.run_name import run_name
from crsfd_jax.options.trials import read as read_trials

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


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
    asked: str = ""
    """What that means, as the table of the trials says it."""


class Experiment(NamedTuple):
    """A file of the folder experiments/."""

    name: str
    description: str
    cells: tuple[Cell, ...]
    demos: Mapping[str, tuple[str, ...]]
    """Files of demonstrations, and what `python -m crsfd_jax.demos` is called with to make each."""


def load(name: str, also: tuple[str, ...] = ()) -> Experiment:
    """Reads an experiment by its name or by the path of its .py file, which is executed.

    A file holds `CELLS`, a tuple of tuples of arguments; its docstring's first line describes it.
    It may hold `DEMOS` and `TRIALS` as well: see `Experiment.demos` and `Cell.trials`.

    Args:
      also: arguments that every cell gets besides its own.

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
    lists, demos = found.get("CELLS"), found.get("DEMOS", {})
    if not lists:
        raise UserError(f"{path}: defines no CELLS, expected a tuple of argument tuples; add it")
    if not _are_words(lists):
        raise UserError(f"{path}: CELLS: got {lists!r}, expected a tuple of argument tuples")
    if not isinstance(demos, Mapping) or not _are_words(list(demos.values())):
        raise UserError(f"{path}: DEMOS: got {demos!r}, expected files and argument tuples")
    trials = found.get("TRIALS", ())
    if not _are_words([trials]):
        raise UserError(f"{path}: TRIALS: got {trials!r}, expected a tuple of arguments")
    cells = tuple(
        _cell(path, number, (*given, *also), tuple(map(str, trials)))
        for number, given in enumerate(lists)
    )
    twice = [name for name, count in Counter(cell.name for cell in cells).items() if count > 1]
    if twice:
        raise UserError(
            f"{path}: cell {twice[0]} is there more than once (--steps and --evaluation.* are no "
            "part of a name); keep one of them"
        )
    description = (found["__doc__"] or path.stem).strip().splitlines()[0]
    made = {str(file): tuple(map(str, words)) for file, words in demos.items()}
    return Experiment(path.stem, description, cells, made)


def available() -> list[Path]:
    """The files of experiments/ that hold cells."""
    files = sorted(EXPERIMENTS.glob("*.py"))
    return [path for path in files if re.search(r"^CELLS = ", path.read_text(), re.MULTILINE)]


def _are_words(lists: Any) -> bool:
    """Whether these are several lists of arguments."""
    return isinstance(lists, list | tuple) and all(isinstance(one, list | tuple) for one in lists)


def _cell(path: Path, number: int, given: Sequence[Any], trials: tuple[str, ...]) -> Cell:
    try:
        arguments = tuple(map(str, given))
        config = cli.parse(Config, arguments)
        asked = read_trials(("RUN", *trials), lambda _: config)[-1] if trials else ""
    except UserError as error:
        raise UserError(f"{path}: cell {number}: {error}") from error
    if config.out:
        raise UserError(f"{path}: cell {number}: --out: got {config.out!r}, allowed: none; drop it")
    return Cell(run_name(config), arguments, config, trials, asked)
