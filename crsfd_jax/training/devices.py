"""What a run computes on: one device, or several on several hosts with a share of the seeds each.

Processes are joined before anything else asks for a device, as their environment says:
JAX_COORDINATOR_ADDRESS (host:port of the first one), JAX_NUM_PROCESSES and JAX_PROCESS_ID. All run
the same program on the same command; the first one owns the run folder and tells the others what
lies in it.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from crsfd_jax.config import Config
from crsfd_jax.errors import UserError
from crsfd_jax.physics import select
from crsfd_jax.storage.leaves import is_key

SEEDS, WHOLE = PartitionSpec("seed"), PartitionSpec()
_JOIN = ("JAX_COORDINATOR_ADDRESS", "JAX_NUM_PROCESSES", "JAX_PROCESS_ID")


def describe(config: Config) -> str:
    """Devices and engine of a run in words."""
    found = jax.devices()
    kind, cores = found[0].device_kind, ""
    if jax.default_backend() == "cpu":
        kind, cores = _processor() or kind, f", {len(os.sched_getaffinity(0))} cores"
    return f"{len(found)} x {kind}{cores}, engine {select.resolve(config.engine)}"


def join() -> None:
    """Joins the other processes of the run, if the environment names any.

    Raises:
      UserError: it names them in part.
    """
    address, number, own = (os.environ.get(name, "") for name in _JOIN)
    if not address:
        return
    if not (number.isdecimal() and own.isdecimal() and int(own) < int(number)):
        raise UserError(
            f"{_JOIN[1]} and {_JOIN[2]}: got {number!r} and {own!r}, allowed: a number of "
            f"processes and a smaller number from 0; set them, or unset {_JOIN[0]}"
        )
    jax.distributed.initialize(address, int(number), int(own))


def is_first() -> bool:
    """Whether this process owns the run folder."""
    return jax.process_index() == 0


def mesh(seeds: int) -> Mesh:
    """As many devices of each process as divide the seeds evenly.

    Raises:
      UserError: the processes themselves do not.
    """
    processes = jax.process_count()
    if seeds % processes:
        raise UserError(
            f"--seeds: got {seeds} in all, allowed with {processes} processes: multiples of "
            f"{processes}; change it or start fewer"
        )
    owned = [[d for d in jax.devices() if d.process_index == p] for p in range(processes)]
    most = min(map(len, owned))
    share = max(n for n in range(1, most + 1) if seeds // processes % n == 0)
    return Mesh(np.array([device for devices in owned for device in devices[:share]]), ("seed",))


def split(
    function: Callable[..., Any], mesh: Mesh | None, *others: PartitionSpec
) -> Callable[..., Any]:
    """The function with each device computing its seeds: [S] of the first argument and result.

    Only so does a simulation on the host run its own seeds on each device; under jit alone every
    device would simulate all of them.

    Args:
      others: SEEDS or WHOLE for each further argument.
    """
    if mesh is None or mesh.size == 1:
        return function
    return jax.shard_map(
        function, mesh=mesh, in_specs=(SEEDS, *others), out_specs=SEEDS, check_vma=False
    )


def place(states: Any, mesh: Mesh) -> Any:
    """Lays states [S] that every process holds out over the devices."""
    if mesh.size == 1:
        return states
    # jax.device_put does not lay typed PRNG keys out over devices of other processes.
    return jax.jit(lambda x: x, out_shardings=NamedSharding(mesh, SEEDS))(states)


def collect(states: Any) -> Any:
    """States [S] of all processes in every one of them."""
    if jax.process_count() == 1:
        return states
    return jax.tree.map(_collect_leaf, states)


def from_first(tree: Any) -> Any:
    """What the first process holds, in all of them; leaves are arrays and typed PRNG keys."""
    if jax.process_count() == 1:
        return tree
    words = jax.tree.map(lambda x: jax.random.key_data(x) if is_key(x) else x, tree)
    told = multihost_utils.broadcast_one_to_all(words)
    return jax.tree.map(_as_kind_of, told, tree)


def text_from_first(text: str) -> str:
    """The text that the first process holds, in all of them."""
    if jax.process_count() == 1:
        return text
    content = text.encode()
    size = int(multihost_utils.broadcast_one_to_all(np.int64(len(content))))
    padded = np.frombuffer(content[:size].ljust(size), np.uint8)
    return bytes(np.asarray(multihost_utils.broadcast_one_to_all(padded))).decode()


def any_of(flag: bool) -> bool:
    """Whether the flag is set in any process."""
    if jax.process_count() == 1:
        return flag
    return bool(multihost_utils.process_allgather(np.array(flag)).any())


def _processor() -> str:
    """The model of this machine's processor, empty where the system does not tell it."""
    told = Path("/proc/cpuinfo")
    lines = told.read_text().splitlines() if told.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else ""


def _collect_leaf(leaf):
    words = jax.random.key_data(leaf) if is_key(leaf) else leaf
    return _as_kind_of(multihost_utils.process_allgather(words, tiled=True), leaf)


def _as_kind_of(words, leaf):
    if not is_key(leaf):
        return words
    return jax.random.wrap_key_data(words, impl=jax.random.key_impl(leaf))
