"""`python -m crsfd_jax.sweep --experiment NAME`: all runs of an experiment, one after the other.

Exit codes: 0 all done, 1 some failed, 75 stopped or not finished: the same command goes on.
"""

import fnmatch
import shlex
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from crsfd_jax import cli
from crsfd_jax.errors import DONE, MISSED, STOPPED, UserError
from crsfd_jax.interrupt import Interrupt
from crsfd_jax.options.limits import Interval
from crsfd_jax.options.together import likeness
from crsfd_jax.progress import say
from crsfd_jax.storage import artefacts, run_folder
from crsfd_jax.storage.files import output
from crsfd_jax.sweeps import (
    attempt,
    cells,
    demonstrations,
    local_pool,
    ray_tasks,
    slurm_array,
    state,
)
from crsfd_jax.sweeps.attempt import CellResult, Group, Plan
from crsfd_jax.sweeps.cells import Cell
from crsfd_jax.sweeps.slurm_array import Slurm

_WAIT_S = 2.0
"""Between two looks at cells that another sweep runs."""


@dataclass(frozen=True)
class Sweep:
    """Runs the cells of an experiment that are not done yet; the same command again goes on.

    What follows `--` is given to every cell besides its own options: -- --sac.reward-scale 1
    """

    experiment: str
    """Name of a file in experiments/, such as setting1, or the path of a .py file."""
    only: str = "*"
    """Cells whose name matches this pattern, such as 'crsfd-shape2*'."""
    out: str = ""
    """Folder of the run folders; runs/EXPERIMENT if empty. Experiments that share one share runs
    of the same options, evaluations included."""
    status: bool = False
    """Print how far every cell is, and do nothing."""
    dry_run: bool = False
    """Print the commands that would run, and do nothing."""
    runner: Literal["local", "ray", "slurm"] = "local"
    """What runs the cells: processes of this machine, a Ray cluster, or a SLURM job array."""
    workers: Annotated[int, Interval(1, 10_000)] = 1
    """Processes at a time, each with its share of the CPU cores; one for each core is fastest."""
    together: Annotated[int, Interval(1, 1000)] = 1
    """Cells in one process and program, of those that differ in shape, shift and seeds alone; it
    may help where one run leaves a GPU idle, and does not on a CPU."""
    retries: Annotated[int, Interval(0, 100)] = 1
    """How often a cell that fails is continued before it is given up."""
    gpus: Annotated[float, Interval(0, 64)] = 0.0
    """GPUs of a process under ray and slurm; ray takes fractions such as 0.25."""
    slurm: Slurm = field(default_factory=Slurm)


def run(argv: list[str], command: Sequence[str] = attempt.TRAIN) -> int:
    """Sweeps as the command line says; see --help.

    Args:
      command: what trains a cell, given its arguments.
    """
    start = argv.index("--") if "--" in argv else len(argv)
    argv, also = argv[:start], argv[start:]
    options = cli.parse(Sweep, argv)
    _refuse_idle(options)
    experiment = cells.load(options.experiment, tuple(also[1:]))
    chosen = [cell for cell in experiment.cells if fnmatch.fnmatch(cell.name, options.only)]
    if not chosen:
        raise UserError(
            f"--only: got {options.only!r}, allowed: a pattern of a name such as "
            f"{experiment.cells[0].name}; see --status for all"
        )
    plan = Plan(
        out=Path(options.out or f"runs/{experiment.name}").absolute(),
        command=tuple(command),
        retries=options.retries,
        environment=_memory_shares(options),
    )
    if plan.out.exists() and not plan.out.is_dir():
        raise UserError(f"--out: got {options.out!r}, a file, allowed: a folder; choose another")
    say(f"{experiment.name}: {experiment.description}")
    say(f"{len(chosen)} of {len(experiment.cells)} cells, in {plan.out}")
    if options.status:
        _show(chosen, plan, 0)
        return DONE
    unfinished = [cell for cell in chosen if not state.is_done(plan.out, cell)]
    if options.dry_run:
        for command in demonstrations.commands(experiment, unfinished).values():
            say(shlex.join(command))
        _show(chosen, plan, options.together)
        return DONE
    with output(options.out or plan.out):
        plan.out.mkdir(parents=True, exist_ok=True)
    demonstrations.make(experiment, unfinished)
    return _work(chosen, plan, _runner(options, plan), options.together)


def _refuse_idle(options: Sweep) -> None:
    """Raises UserError for options that would do nothing beside the others."""
    if options.gpus and options.runner == "local":
        raise UserError(
            f"--gpus: got {options.gpus:g} with --runner local, allowed with ray and slurm; leave "
            "it out, or choose another runner"
        )
    if options.gpus % 1 and options.runner == "slurm":
        raise UserError(
            f"--gpus: got {options.gpus:g}, allowed with slurm: whole ones; round it up"
        )
    if options.slurm != Slurm() and options.runner != "slurm":
        raise UserError(
            f"--slurm: got options of it with --runner {options.runner}, allowed with slurm; leave "
            "them out, or choose that runner"
        )
    if options.status and options.dry_run:
        raise UserError("--status: got --dry-run as well, allowed: one of them; leave one out")


Runner = Callable[[Sequence[Group], Callable[[], bool]], Iterator[CellResult]]


def _runner(options: Sweep, plan: Plan) -> Runner:
    places, gpus = options.workers, options.gpus
    if options.runner == "local":
        return lambda todo, stop: local_pool.run(todo, plan, places, stop)
    if options.runner == "ray":
        return lambda todo, stop: ray_tasks.run(todo, plan, places, gpus, stop)
    return lambda todo, stop: slurm_array.run(todo, plan, places, gpus, options.slurm, stop)


def grouped(free: Sequence[Cell], out: Path, most: int) -> list[Group]:
    """Cells that go together, at most so many: alike, and as far as each other."""
    alike: dict[tuple, list[Cell]] = {}
    for cell in free:
        saved = artefacts.saved_steps(run_folder.at(out / cell.name).checkpoints)
        alike.setdefault((likeness(cell.config), *saved[:1]), []).append(cell)
    groups = [
        tuple(cells[start : start + most])
        for cells in alike.values()
        for start in range(0, len(cells), most)
    ]
    return sorted(groups, key=lambda group: free.index(group[0]))


def _memory_shares(options: Sweep) -> tuple[tuple[str, str], ...]:
    """jax takes most of a GPU's memory at its start unless it is told its share."""
    share = 1 / options.workers if options.runner == "local" else options.gpus
    return (("XLA_PYTHON_CLIENT_MEM_FRACTION", f"{0.9 * share:.3f}"),) if 0 < share < 1 else ()


def _work(chosen: Sequence[Cell], plan: Plan, runner: Runner, together: int) -> int:
    """Runs cells until each has ended, waiting for those that another sweep has."""
    ended: dict[str, CellResult] = {}
    waited = False
    with Interrupt() as interrupt:
        while not interrupt.requested:
            words = {cell: state.read(plan.out, cell).word for cell in chosen}
            for cell in chosen:
                if words[cell] == "done" and cell.name not in ended:
                    ended[cell.name] = CellResult(cell.name, "done")
            free = [c for c in chosen if c.name not in ended and words[c] != "running"]
            groups = grouped(free, plan.out, together)
            for outcome in runner(groups, lambda: interrupt.requested) if groups else ():
                if outcome.word != "busy":
                    ended[outcome.name] = outcome
                    say(f"[{len(ended)}/{len(chosen)}] {outcome.word:7s} {outcome.name}")
            left = len(chosen) - len(ended)
            if not left:
                break
            if not waited:
                say(f"waiting for cells that run elsewhere, {left} now")
            waited = True
            time.sleep(_WAIT_S)
    return _summarise(chosen, plan, ended, interrupt.requested)


def _summarise(
    chosen: Sequence[Cell], plan: Plan, ended: dict[str, CellResult], interrupted: bool
) -> int:
    failed = [outcome for outcome in ended.values() if outcome.word == "failed"]
    done = sum(outcome.word == "done" for outcome in ended.values())
    for outcome in failed:
        say(f"failed  {plan.out / outcome.name}.log")
        for line in outcome.tail:
            say(f"    {line}")
    left = len(chosen) - done - len(failed)
    say(f"{done} done, {len(failed)} failed, {left} to be continued by the same command")
    if left and (interrupted or not failed):
        return STOPPED
    return MISSED if failed else DONE


def _show(chosen: Sequence[Cell], plan: Plan, together: int) -> None:
    """A line for each cell, and the commands that would run so many at a time, if any."""
    states = [state.read(plan.out, cell) for cell in chosen]
    words = {cell: at.word for cell, at in zip(chosen, states, strict=True)}
    free = [cell for cell in chosen if together and words[cell] not in ("done", "running")]
    groups = {group[0]: group for group in grouped(free, plan.out, together)}
    width = max(len(cell.name) for cell in chosen)
    say(f"{'cell':{width}s}  state    env steps          success  wall min")
    for cell, at in zip(chosen, states, strict=True):
        steps = f"{at.env_steps:,}/{cell.config.steps:,}"
        success = "" if at.success is None else f"{at.success:.3f}"
        minutes = f"{at.wall_s / 60:.1f}" if at.wall_s else ""
        say(f"{cell.name:{width}s}  {at.word:7s}  {steps:17s}  {success:>7s}  {minutes:>8s}")
        if cell in groups:
            left = [c for c in groups[cell] if not state.is_finished(plan.out / c.name, c.config)]
            if left:
                say(f"    {shlex.join(attempt.command_of(left, plan))}")
            for each in groups[cell]:
                if each.trials:
                    say(f"    {shlex.join(attempt.trials_of(each, plan))}")
    counts = Counter(at.word for at in states)
    say(", ".join(f"{count} {word}" for word, count in counts.items()))


if __name__ == "__main__":
    cli.main(run)
