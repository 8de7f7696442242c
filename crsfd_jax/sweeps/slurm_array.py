"""Cells as the tasks of a SLURM job array, through submitit."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

from crsfd_jax import extras
from crsfd_jax.errors import UserError
from crsfd_jax.interrupt import Interrupt
from crsfd_jax.options.limits import Interval
from crsfd_jax.sweeps.attempt import CellResult, Group, Plan, run_group

_POLL_S = 2.0
_TIMEOUTS = 100
"""How often a job is queued again after its time was up."""
_KEEP_WARNING = ("env", "--ignore-signal=USR2")
"""SLURM warns every process of a job before its time is up; a run would die of the warning."""


@dataclass(frozen=True)
class Slurm:
    """What a process asks of SLURM."""

    partition: str = ""
    """Partition; empty for the cluster's default."""
    minutes: Annotated[int, Interval(1, 100_000)] = 240
    """Time limit of a job, after which it is queued again and goes on."""
    cores: Annotated[int, Interval(1, 1024)] = 4
    """CPU cores of a process."""


class Job(NamedTuple):
    """A group as submitit wants it: called in the job, `checkpoint` says how to go on."""

    group: Group
    plan: Plan

    def __call__(self) -> list[CellResult]:
        with Interrupt() as interrupt:
            return run_group(self.group, self.plan, lambda: interrupt.requested)

    def checkpoint(self) -> Any:
        """Called when the time is up; cells find their own place in their run folders."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)


def run(
    groups: Sequence[Group],
    plan: Plan,
    workers: int,
    gpus: float,
    slurm: Slurm,
    stopping: Callable[[], bool],
    cluster: str = "slurm",
) -> Iterator[CellResult]:
    """Submits an array of the groups, `workers` at a time, and waits for it.

    Args:
      cluster: submitit's name of what runs the jobs.

    Yields:
      What became of each cell, as soon as its group has ended.

    Raises:
      UserError: submitit is not installed, there is no SLURM here, or it refuses the array.
    """
    extras.require("--runner slurm", "slurm", "submitit")
    import submitit

    try:
        executor = submitit.AutoExecutor(
            plan.out / ".slurm", cluster, slurm_max_num_timeout=_TIMEOUTS
        )
    except RuntimeError as error:
        raise UserError(f"--runner slurm: {error}; choose local or ray here") from error
    asked: dict[str, Any] = {"slurm_partition": slurm.partition} if slurm.partition else {}
    executor.update_parameters(
        name="crsfd_jax",
        timeout_min=slurm.minutes,
        cpus_per_task=slurm.cores,
        gpus_per_node=int(gpus),
        slurm_array_parallelism=workers,
        **asked,
    )
    plan = plan._replace(command=(*_KEEP_WARNING, *plan.command))
    try:
        with executor.batch():
            jobs = {group: executor.submit(Job(group, plan)) for group in groups}
    except RuntimeError as error:
        raise UserError(f"--runner slurm: the array was refused: {error}") from error
    cancelled = False
    while jobs:
        if stopping() and not cancelled:
            cancelled = True
            for job in jobs.values():
                job.cancel()
        for group in [group for group, job in jobs.items() if job.done()]:
            yield from _outcomes(group, jobs.pop(group), cancelled)
        time.sleep(_POLL_S if jobs else 0)


def _outcomes(group: Group, job: Any, cancelled: bool) -> list[CellResult]:
    error = job.exception()
    if error is None:
        return job.result()
    if cancelled:
        return [CellResult(cell.name, "stopped") for cell in group]
    lines = tuple(str(error).strip().splitlines()[-5:])
    return [CellResult(cell.name, "failed", lines) for cell in group]
