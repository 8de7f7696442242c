"""The rows of metrics.csv for TensorBoard or Weights & Biases, while they appear.

metrics.csv is the truth: what the tools are given is made from it anew whenever a run starts or
resumes, so that stops leave neither gaps nor duplicates. Names are those of its columns.
"""

import contextlib
import hashlib
import importlib
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from crsfd_jax import extras
from crsfd_jax.config import to_dict
from crsfd_jax.errors import UserError
from crsfd_jax.storage import manifest, metrics, run_folder
from crsfd_jax.storage.manifest import Manifest

_NEEDS = {"tensorboard": ("tb", "tensorboardX"), "wandb": ("wandb", "wandb")}
"""Extra and module of each tool."""

Row = dict[str, float]
Write = Callable[[Sequence[Row]], None]


def require(tool: str) -> None:
    """Checks that a tool can be used.

    Raises:
      UserError: its package is missing.
    """
    if tool != "none":
        extras.require(f"--log {tool}", *_NEEDS[tool])


@contextlib.contextmanager
def opened(tool: str, folder: Path, seeds: range) -> Iterator[Callable[[], None]]:
    """Gives the function that passes on what metrics.csv has gained since its last call.

    Raises:
      UserError: the tool's package is missing, or it cannot begin.
    """
    if tool == "none":
        yield lambda: None
        return
    require(tool)
    sink = {"tensorboard": _tensorboard, "wandb": _wandb}[tool]
    passed = 0

    def update() -> None:
        nonlocal passed
        rows = _rows(run_folder.at(folder).metrics)
        write(rows[passed:])
        passed = len(rows)

    with sink(folder, seeds) as write:
        update()
        yield update


def _rows(path: Path) -> list[Row]:
    if not path.exists():
        return []
    table = metrics.read(path)
    return [
        dict(zip(table, line, strict=True))
        for line in zip(*(column.tolist() for column in table.values()), strict=True)
    ]


@contextlib.contextmanager
def _tensorboard(folder: Path, seeds: range) -> Iterator[Write]:
    # Not its SummaryWriter: that hands events to a thread, and its flush does not wait for them.
    from tensorboardX.event_file_writer import EventsWriter
    from tensorboardX.proto.event_pb2 import Event, SessionLog
    from tensorboardX.proto.summary_pb2 import Summary

    root, writers = folder / "tensorboard", {}
    shutil.rmtree(root, ignore_errors=True)
    for seed in seeds:
        (root / f"seed{seed}").mkdir(parents=True)
        writers[seed] = EventsWriter(str(root / f"seed{seed}" / "events"))
        # A TensorBoard that is looking already shall forget what it has read.
        writers[seed].write_event(Event(session_log=SessionLog(status=SessionLog.START)))
    newest = _rows(run_folder.at(folder).metrics)[-1:]
    began = time.time() - sum(row["time/wall_s"] for row in newest)

    def write(rows: Sequence[Row]) -> None:
        for row in rows:
            values = [Summary.Value(tag=n, simple_value=v) for n, v in _values(row).items()]
            event = Event(
                wall_time=began + row["time/wall_s"],
                step=int(row["env_steps"]),
                summary=Summary(value=values),
            )
            writers[int(row["seed"])].write_event(event)
        for writer in writers.values():
            writer.flush()

    try:
        yield write
    finally:
        for writer in writers.values():
            writer.close()


@contextlib.contextmanager
def _wandb(folder: Path, seeds: range) -> Iterator[Write]:
    wandb = importlib.import_module("wandb")

    # Training never waits for a network: what is kept here can be uploaded with `wandb sync`.
    mode = os.environ.get("WANDB_MODE", "offline")
    shutil.rmtree(folder / "wandb", ignore_errors=True)
    told = manifest.read(run_folder.at(folder).config)

    def begin(seed: int):
        return wandb.init(
            project=os.environ.get("WANDB_PROJECT", "crsfd_jax"),
            group=folder.name,
            name=f"{folder.name}-seed{seed}",
            id=_identity(folder.name, told, seed),
            config=to_dict(told.config) | {"seed": seed},
            dir=folder,
            mode=mode,
            resume="allow",
            reinit="create_new",
            settings=wandb.Settings(console="off", silent=True),
        )

    with contextlib.ExitStack() as stack:
        try:
            runs = {seed: stack.enter_context(begin(seed)) for seed in seeds}
        except (wandb.errors.Error, ValueError) as error:
            raise UserError(
                f"--log wandb: got WANDB_MODE={mode}: {error}; correct it, or leave it out to "
                "keep the rows in the run folder"
            ) from error

        def write(rows: Sequence[Row]) -> None:
            for row in rows:
                run, step = runs[int(row["seed"])], int(row["env_steps"])
                # A run that goes on elsewhere has its first rows already.
                if step >= run.step:
                    run.log(_values(row), step=step, commit=True)

        yield write


def _values(row: Row) -> Row:
    return {name: value for name, value in row.items() if name not in metrics.KEY_COLUMNS}


def _identity(name: str, told: Manifest, seed: int) -> str:
    """Same for all parts of a stopped and resumed run, other for one started anew or beside it."""
    words = f"{name} {told.started} {[told.config.shape, told.config.shift]} {seed}"
    return hashlib.sha256(words.encode()).hexdigest()[:16]
