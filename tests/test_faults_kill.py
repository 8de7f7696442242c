"""Runs that are killed and stopped at random moments end as one that never was."""

import concurrent.futures
import signal
import time
from pathlib import Path

import fault_runs
import numpy as np
import pytest

pytestmark = pytest.mark.faults
AT_A_TIME, AT_AN_OPERATION, IN_A_SAVE = 7, 6, 7
"""Twenty kills."""
OPERATIONS = 50
"""Fewer than a run makes on files: two checkpoints of 18 each, and the rest."""
MOMENTS = (("folder", 0.3), ("compiling", 0.3), ("128/4,096 steps", 0.03))
"""Line of the output, and seconds after it in which a run is far from its end on any machine."""


@pytest.fixture(scope="module")
def seconds(whole, tmp_path_factory) -> float:
    """How long a run takes from the cache."""
    folder = tmp_path_factory.mktemp("timed") / "run"
    return fault_runs.timed(lambda: fault_runs.run(folder))


def until_killed(base: Path, whole: Path, kills: int, attempt) -> int:
    """Kills so many times; a run that ends before is compared, and the next one begins.

    Args:
      attempt: folder -> exit code of a run that was perhaps killed.

    Returns:
      Kills that left a checkpoint half written.
    """
    killed = saving = runs = 0
    while killed < kills:
        folder = base / str(runs)
        code = attempt(folder)
        if code == -signal.SIGKILL:
            killed += 1
            saving += fault_runs.was_saving(folder)
        else:
            assert code == 0
            fault_runs.assert_same(folder, whole)
            runs += 1
    folder = base / str(runs)
    code, out = fault_runs.run(folder)
    assert code == 0, out
    assert fault_runs.free_of_damage(folder)
    fault_runs.assert_same(folder, whole)
    return saving


@pytest.mark.timeout(3000)
def test_a_run_killed_at_twenty_random_moments_ends_as_one_that_never_was(whole, seconds, tmp_path):
    rng = np.random.default_rng(0)
    times = iter(rng.uniform(0, seconds, 1000))
    numbers = iter(rng.integers(1, OPERATIONS, 1000))
    saves = iter(rng.integers(1, 3, 1000))
    # Most of a save passes in its first milliseconds where the disk is fast.
    delays = iter(10 ** rng.uniform(2, 4.5, 1000))

    def at_a_time(folder):
        return fault_runs.stopped_after(folder, next(times))[0]

    def at_an_operation(folder):
        return fault_runs.run(folder, fault="kill", n=next(numbers))[0]

    def in_a_save(folder):
        return fault_runs.run(folder, fault=f"save{next(saves)}", n=int(next(delays)))[0]

    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        done = [
            pool.submit(until_killed, tmp_path / attempt.__name__, whole, kills, attempt)
            for attempt, kills in (
                (in_a_save, IN_A_SAVE),
                (at_a_time, AT_A_TIME),
                (at_an_operation, AT_AN_OPERATION),
            )
        ]
        saving, *_ = (one.result() for one in done)
    assert saving >= 5


def test_every_signal_at_a_random_moment_stops_a_run_in_order(whole, tmp_path):
    rng = np.random.default_rng(1)
    numbers = rng.permutation([signal.SIGTERM, signal.SIGINT, signal.SIGHUP]).tolist()
    for number, (line, at_most) in zip(numbers, MOMENTS, strict=True):
        folder = tmp_path / str(number)
        process = fault_runs.start(folder)
        fault_runs.wait_for(process, line)
        time.sleep(rng.uniform(0, at_most))
        process.send_signal(number)
        out, _ = process.communicate(timeout=500)
        assert process.returncode == 75, out
        assert "go on with the same command" in out
        code, out = fault_runs.run(folder)
        assert code == 0 and "resumed at" in out
        fault_runs.assert_same(folder, whole)


def test_a_second_signal_ends_a_run_at_once_and_loses_nothing(whole, tmp_path):
    process = fault_runs.start(tmp_path / "run")
    fault_runs.wait_for(process, "folder")
    process.send_signal(signal.SIGTERM)
    fault_runs.wait_for(process, "stopping after this step")
    time.sleep(1.1)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=100)
    assert process.returncode in (128 + signal.SIGTERM, 75)
    assert fault_runs.run(tmp_path / "run")[0] == 0
    fault_runs.assert_same(tmp_path / "run", whole)
