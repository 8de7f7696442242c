"""How far a run is: a live bar on a terminal, now and then a plain line elsewhere."""

import contextlib
import datetime
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from crsfd_jax.silence import silence

Update = Callable[[int, Sequence[float]], None]


@contextlib.contextmanager
def progress(
    total_steps: int, done_steps: int = 0, interval_s: float = 10.0, stream: TextIO | None = None
) -> Iterator[Update]:
    """Shows a run's progress while the block lasts; a closed output never stops the run.

    Args:
      total_steps: environment steps of each seed at the end of the run.
      done_steps: those made before the run was continued.
      interval_s: time between two plain lines.
      stream: stdout unless given.

    Yields:
      update(env_steps, success), to call after each chunk with the newest success rate of
      each seed, or with an empty sequence before the first evaluation.
    """
    output = _Unbreakable(stream or sys.stdout)
    with _bar(output, total_steps) if output.isatty() else _lines(output, interval_s) as show:
        started = time.monotonic()

        def update(env_steps: int, success: Sequence[float]) -> None:
            rate = (env_steps - done_steps) / max(time.monotonic() - started, 1e-9)
            show(env_steps, status_line(env_steps, total_steps, rate, success))

        yield update


def say(line: str) -> None:
    """Prints a line; a closed output never stops the run."""
    output = _Unbreakable(sys.stdout)
    output.write(f"{line}\n")
    output.flush()


def status_line(
    env_steps: int, total_steps: int, steps_per_second: float, success: Sequence[float]
) -> str:
    """One line: steps, speed, time left, success rate as a mean and of each seed."""
    left = "unknown"
    if steps_per_second > 0:
        seconds = round((total_steps - env_steps) / steps_per_second)
        left = str(datetime.timedelta(seconds=max(0, seconds)))
    line = f"{env_steps:,}/{total_steps:,} steps  {steps_per_second:,.0f} steps/s  left {left}"
    if len(success) == 0:
        return line
    seeds = " ".join(f"{rate:.2f}" for rate in success)
    return f"{line}  success {sum(success) / len(success):.2f} [{seeds}]"


Show = Callable[[int, str], None]


@contextlib.contextmanager
def _bar(output: "_Unbreakable", total_steps: int) -> Iterator[Show]:
    console = Console(file=output)  # type: ignore[arg-type]
    columns = (BarColumn(bar_width=20), TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=console, refresh_per_second=2) as bar:
        task = bar.add_task("compiling", total=total_steps)
        yield lambda env_steps, line: bar.update(task, completed=env_steps, description=line)


@contextlib.contextmanager
def _lines(output: "_Unbreakable", interval_s: float) -> Iterator[Show]:
    last_shown = -interval_s
    latest = ""

    def show(_: int, line: str) -> None:
        nonlocal last_shown, latest
        latest = line
        if time.monotonic() - last_shown >= interval_s:
            output.write(f"{line}\n")
            output.flush()
            last_shown, latest = time.monotonic(), ""

    try:
        yield show
    finally:
        output.write(f"{latest}\n" if latest else "")
        output.flush()


class _Unbreakable:
    """A text stream that goes silent when its reader is gone, as in `train | head -1`."""

    def __init__(self, stream: TextIO):
        self._stream = stream
        self.encoding = stream.encoding

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._stream.fileno()

    def write(self, text: str) -> int:
        with self._silenced_when_broken():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with self._silenced_when_broken():
            self._stream.flush()

    @contextlib.contextmanager
    def _silenced_when_broken(self) -> Iterator[None]:
        try:
            yield
        except OSError:
            silence(self._stream)
