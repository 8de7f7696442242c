"""Where the parts of a run lie.

config.json     every option, the versions, the device and the command line
metrics.csv     one row for each evaluation of each seed
checkpoints/    the newest complete states of the run
policy.npz      parameters of the trained policies
curves.png      success against environment steps
clips/          films of the policy, if asked for
trials.csv      trials of the policies, if it is a cell of an experiment that has some
"""

from pathlib import Path
from typing import NamedTuple


class RunFolder(NamedTuple):
    """The folder of a run and what is in it."""

    path: Path
    config: Path
    metrics: Path
    checkpoints: Path
    policy: Path
    curves: Path
    clips: Path
    trials: Path
    lock: Path
    """Held by the process that the run is made in."""


def at(path: str | Path) -> RunFolder:
    """The folder of a run, whether it is there or not."""
    path = Path(path)
    return RunFolder(
        path=path,
        config=path / "config.json",
        metrics=path / "metrics.csv",
        checkpoints=path / "checkpoints",
        policy=path / "policy.npz",
        curves=path / "curves.png",
        clips=path / "clips",
        trials=path / "trials.csv",
        lock=path / ".lock",
    )
