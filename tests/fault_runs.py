"""Small runs that are stopped, and the comparison of what they left with a run that never was."""

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from crsfd_jax.storage import metrics

DRIVER = Path(__file__).with_name("fault_driver.py")
OPTIONS = (
    *("--smoke", "--shape", "3", "--shift", "4mm", "--envs", "8", "--mdp.horizon", "20"),
    *("--potential.steps", "20", "--sac.hidden", "32", "--sac.batch-size", "32"),
)


def command(folder, *options, fault="none", n=0):
    """The same run every time, but for where it goes and what befalls it."""
    return [sys.executable, DRIVER, fault, n, *OPTIONS, *options, "--out", folder]


def start(folder, *options, fault="none", n=0, **more) -> subprocess.Popen:
    """Starts the run; its output comes as one stream of text."""
    words = list(map(str, command(folder, *options, fault=fault, n=n)))
    pipe = subprocess.PIPE
    return subprocess.Popen(words, stdout=pipe, stderr=subprocess.STDOUT, text=True, **more)


def run(folder, *options, fault="none", n=0, **more) -> tuple[int, str]:
    """Runs to the end that it comes to: exit code and output."""
    process = start(folder, *options, fault=fault, n=n, **more)
    out, _ = process.communicate(timeout=500)
    return process.returncode, out


def stopped_after(folder, seconds: float, number: int = signal.SIGKILL) -> tuple[int, str]:
    """Runs until a signal after some time, if it runs as long: exit code and output."""
    process = start(folder)
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.send_signal(number)
    out, _ = process.communicate(timeout=500)
    return process.returncode, out


def wait_for(process: subprocess.Popen, beginning: str) -> str:
    """Reads the output up to the line with this beginning."""
    assert process.stdout is not None
    read = []
    for line in process.stdout:
        read.append(line)
        if line.startswith(beginning):
            return line
    raise AssertionError(f"no line {beginning!r} in:\n{''.join(read)}")


def free_of_damage(folder: Path) -> bool:
    """Whether no checkpoint was ever set aside as damaged."""
    return not list((folder / "checkpoints").glob("*.damaged*"))


def was_saving(folder: Path) -> bool:
    """Whether a process that was killed left a checkpoint that was being written."""
    return any((folder / "checkpoints").glob("*.orbax-checkpoint-tmp"))


def assert_same(folder: Path, whole: Path) -> None:
    """The same metrics but for wall-clock time, the same policies, the same complete states."""
    one, other = (metrics.read(path / "metrics.csv") for path in (whole, folder))
    assert one.keys() == other.keys()
    for name in one.keys() - set(metrics.WALL_CLOCK_COLUMNS):
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    with np.load(whole / "policy.npz") as a, np.load(folder / "policy.npz") as b:
        assert a.files == b.files
        for name in a.files:
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)
    assert digests(folder) == digests(whole)


def digests(folder: Path) -> dict[str, str]:
    """Leaf of the newest checkpoint -> SHA-256 of its bytes: networks, optimisers, buffer, all."""
    newest = max(folder.glob("checkpoints/[0-9]*"), key=lambda path: int(path.name))
    description = json.loads((newest / "_CHECKPOINT_METADATA").read_text())
    leaves = json.loads(description["custom_metadata"]["body"])["leaves"]
    assert len(leaves) > 50
    return {name: leaf["sha256"] for name, leaf in leaves.items()}


def respect_permissions() -> None:
    """For a child of root, to which file permissions mean nothing otherwise."""
    if os.geteuid() == 0:
        drop_from_bounding_set, dac_override = 24, 1
        ctypes.CDLL(None).prctl(drop_from_bounding_set, dac_override, 0, 0, 0)


def timed(action) -> float:
    """Seconds that an action takes."""
    began = time.monotonic()
    action()
    return time.monotonic() - began
