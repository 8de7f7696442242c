"""Cells on this machine: a few at a time, each in a process of its own."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from crsfd_jax.sweeps.attempt import CellResult, Group, Plan, run_group


def run(
    groups: Sequence[Group], plan: Plan, workers: int, stopping: Callable[[], bool]
) -> Iterator[CellResult]:
    """Yields what became of each cell as soon as its group has ended."""
    shares = iter(_core_shares(workers))
    with ThreadPoolExecutor(workers, initializer=lambda: _stay_on(next(shares))) as pool:
        futures = [pool.submit(run_group, group, plan, stopping) for group in groups]
        for future in as_completed(futures):
            yield from future.result()


def _core_shares(workers: int) -> list[list[int]]:
    """The cores of this process dealt out to workers, which share them where there are too few."""
    cores = sorted(os.sched_getaffinity(0))
    return [cores[i % len(cores) :: workers] for i in range(workers)]


def _stay_on(cores: list[int]) -> None:
    # Of a thread on Linux; the processes it starts inherit it and size their thread pools by it.
    os.sched_setaffinity(0, cores)
