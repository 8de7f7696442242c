"""Named arrays and a description in a folder, written and read through orbax by one process.

Of several processes that compute together only one saves: orbax is told so, for it would wait
for the others otherwise.
"""

import contextlib
import logging
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
import orbax.checkpoint as ocp


def save(path: Path, arrays: Mapping[str, np.ndarray], description: Mapping[str, Any]) -> None:
    """Writes arrays, none of them empty, and JSON values to a new folder.

    Raises:
      OSError, ValueError: it cannot be written.
    """
    with _opened() as checkpointer:
        arguments = ocp.args.PyTreeSave(dict(arrays))
        checkpointer.save(path, args=arguments, custom_metadata=dict(description))


def load(path: Path, like: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays of a folder, named and shaped as in `like`; damage raises whatever it raises."""
    plain = {name: ocp.RestoreArgs(restore_type=np.ndarray) for name in like}
    with _opened() as checkpointer:
        arguments = ocp.args.PyTreeRestore(item=dict(like), restore_args=plain)
        return checkpointer.restore(path, args=arguments)


def describe(path: Path) -> Any:
    """The JSON values of a folder; damage raises whatever it raises."""
    with _opened() as checkpointer:
        return checkpointer.metadata(path).custom_metadata


@contextlib.contextmanager
def _opened() -> Iterator[ocp.Checkpointer]:
    own = jax.process_index()
    alone = ocp.options.MultiprocessingOptions(
        primary_host=own, active_processes={own}, barrier_sync_key_prefix=f"process{own}"
    )
    # Float noise hardly shrinks, and compressing it takes longer than writing it.
    handler = ocp.PyTreeCheckpointHandler(use_compression=False, multiprocessing_options=alone)
    with _silenced(), ocp.Checkpointer(handler, multiprocessing_options=alone) as checkpointer:
        yield checkpointer


@contextlib.contextmanager
def _silenced() -> Iterator[None]:
    # Before it raises, orbax logs tracebacks and whole files; after it, unfinished writes complain.
    log, hook = logging.getLogger("absl"), sys.unraisablehook
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    sys.unraisablehook = lambda _: None
    try:
        yield
        sys.unraisablehook = hook
    finally:
        log.setLevel(level)
