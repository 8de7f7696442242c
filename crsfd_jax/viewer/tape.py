"""What a person has recorded so far, and saving it."""

import dataclasses
import re
from pathlib import Path

from crsfd_jax import config
from crsfd_jax.demos import dataset, layout
from crsfd_jax.errors import UserError
from crsfd_jax.viewer import hand

_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,99}\.npz")
_COMMAND = "python -m crsfd_jax.view, recorded by hand"


@dataclasses.dataclass
class Tape:
    """Episodes of one task; changed in place."""

    is_running: bool = False
    steps: list[hand.Taken] = dataclasses.field(default_factory=list)
    """Of the episode that goes on."""
    episodes: list[layout.Episode] = dataclasses.field(default_factory=list)

    def cut(self) -> None:
        """Ends the episode that goes on."""
        if self.steps:
            self.episodes.append(hand.episode(self.steps))
            self.steps.clear()

    def forget(self) -> bool:
        """Drops everything; whether there was anything."""
        held = bool(self.steps or self.episodes)
        self.steps.clear()
        self.episodes.clear()
        return held

    def save(self, name: str, options: config.Config, shape: str, shift: float) -> str:
        """Writes a demonstration file into the folder in which the program runs; says what it did.

        A name is no path: who reaches the page shall not write anywhere else.
        """
        if not _NAME.fullmatch(name):
            return "allowed is a name such as by_hand.npz, of letters, digits, ., - and _"
        if Path(name).exists():
            return f"{name} exists; choose another name"
        try:
            demos = hand.demonstrations(self.episodes, options, shape, shift, _COMMAND)
            dataset.save(name, demos)
        except UserError as error:
            return str(error)
        return f"{len(self.episodes)} episodes written to {name}"
