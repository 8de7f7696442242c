"""Stopping in order: the first signal asks, the second one ends the process at once."""

import os
import signal
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupt:
    """While the block lasts, `requested` tells whether a signal has asked the run to stop."""

    def __init__(self) -> None:
        self.requested = False
        self._before: dict[int, object] = {}

    def __enter__(self) -> "Interrupt":
        self._before = {number: signal.signal(number, self._ask) for number in _SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # pyright: ignore[reportArgumentType]

    def _ask(self, number: int, _: FrameType | None) -> None:
        self.requested = True
        os.write(2, b"stopping after this step and saving; once more to stop at once\n")
        signal.signal(number, signal.SIG_DFL)
