"""Cells as tasks of Ray, on this machine or on a cluster whose machines share a folder."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from crsfd_jax import extras
from crsfd_jax.errors import UserError
from crsfd_jax.sweeps.attempt import CellResult, Group, Plan, run_group

_POLL_S = 0.5


def run(
    groups: Sequence[Group],
    plan: Plan,
    workers: int,
    gpus: float,
    stopping: Callable[[], bool],
) -> Iterator[CellResult]:
    """Yields what became of each cell as soon as its group has ended.

    With RAY_ADDRESS set, a group is a task of that cluster; otherwise Ray starts here. At most
    `workers` groups run at a time.

    Raises:
      UserError: Ray is not installed, or there is no cluster at that address.
    """
    extras.require("--runner ray", "ray", "ray")
    import ray

    own_cluster = "RAY_ADDRESS" not in os.environ
    on_terminate = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(num_cpus=workers if own_cluster else None, include_dashboard=False)
    except ConnectionError as error:
        where = os.environ.get("RAY_ADDRESS", "this machine")
        raise UserError(f"--runner ray: no cluster at {where}: {error}") from error
    # Ray takes the signal for itself.
    signal.signal(signal.SIGTERM, on_terminate)
    try:
        task = ray.remote(num_cpus=1, num_gpus=gpus, max_retries=plan.retries)(run_group)
        ahead, running, cancelled = list(groups), {}, False
        while running or (ahead and not cancelled):
            while len(running) < workers and ahead and not cancelled:
                group = ahead.pop(0)
                running[task.remote(group, plan)] = [cell.name for cell in group]
            ready, _ = ray.wait([*running], timeout=_POLL_S)
            if stopping() and not cancelled:
                cancelled = True
                for reference in running.keys() - set(ready):
                    ray.cancel(reference)
            for reference in ready:
                yield from _outcomes(running.pop(reference), reference)
    finally:
        ray.shutdown()


def _outcomes(names: list[str], reference: Any) -> list[CellResult]:
    import ray

    try:
        return ray.get(reference)
    except (ray.exceptions.TaskCancelledError, KeyboardInterrupt):
        return [CellResult(name, "stopped") for name in names]
    except ray.exceptions.RayError as error:
        lines = tuple(str(error).splitlines()[-5:])
        return [CellResult(name, "failed", lines) for name in names]
