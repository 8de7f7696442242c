"""Stopping in order: the first signal asks, a later one ends the process at once."""

import contextlib
import os
import signal
import threading
import time
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_REPEATED_S = 1.0
"""Signals so soon after the first belong to it: batch systems signal every process of a job, and
its parent then passes the signal on."""
_ASKED = b"stopping after this step and saving; again after a second to stop at once\n"


class Interrupt:
    """While the block lasts, `requested` tells whether a signal has asked the run to stop.

    What is ignored when the block begins stays ignored, such as hang-ups under nohup.
    """

    def __init__(self) -> None:
        self.requested = False
        self._before: dict[int, object] = {}

    def __enter__(self) -> "Interrupt":
        taken = [n for n in _SIGNALS if signal.getsignal(n) is not signal.SIG_IGN]
        # Handlers wait until a compilation or a chunk has ended; a thread that is told does not.
        heard, self._told = os.pipe()
        os.set_blocking(self._told, False)
        self._told_before = signal.set_wakeup_fd(self._told, warn_on_full_buffer=False)
        self._before = {number: signal.signal(number, _heard) for number in taken}
        self._watcher = threading.Thread(target=self._watch, args=(heard,), daemon=True)
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # pyright: ignore[reportArgumentType]
        signal.set_wakeup_fd(self._told_before)
        os.close(self._told)
        self._watcher.join()

    def _watch(self, heard: int) -> None:
        asked_at = 0.0
        with open(heard, "rb", buffering=0) as signals:
            while byte := signals.read(1):
                if byte[0] not in self._before:
                    continue
                if not self.requested:
                    self.requested, asked_at = True, time.monotonic()
                    # Of a terminal that was closed there is nobody left to tell.
                    with contextlib.suppress(OSError):
                        os.write(2, _ASKED)
                elif time.monotonic() - asked_at > _REPEATED_S:
                    os._exit(128 + byte[0])


def _heard(_: int, __: FrameType | None) -> None:
    """The watcher does what is to be done."""
