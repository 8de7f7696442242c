"""Runs that are killed and stopped at random moments end as one that never was."""

import concurrent.futures
import signal
from pathlib import Path

import fault_runs
import numpy as np
import pytest

pytestmark = pytest.mark.faults
KILLS = 10
"""Of each kind; the two kinds run side by side."""
OPERATIONS = 60
"""Fewer than a run makes on files: two checkpoints of 20 to 40 each, and the rest."""


@pytest.fixture(scope="module")
def seconds(whole, tmp_path_factory) -> float:
    """How long a run takes from the cache."""
    folder = tmp_path_factory.mktemp("timed") / "run"
    return fault_runs.timed(lambda: fault_runs.run(folder))


def until_killed(base: Path, whole: Path, kill) -> tuple[int, int]:
    """Kills KILLS times; a run that ends before is compared, and the next one begins.

    Args:
      kill: folder -> exit code of a run that was perhaps killed.

    Returns:
      Kills inside a checkpoint write, and runs that came to their end.
    """
    kills = saving = runs = 0
    while kills < KILLS:
        folder = base / str(runs)
        code = kill(folder)
        if code == -signal.SIGKILL:
            kills += 1
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
    return saving, runs + 1


@pytest.mark.timeout(3000)
def test_a_run_killed_at_twenty_random_moments_ends_as_one_that_never_was(whole, seconds, tmp_path):
    rng = np.random.default_rng(0)
    times = iter(rng.uniform(0, seconds, 1000))
    numbers = iter(rng.integers(1, OPERATIONS, 1000))

    def at_a_time(folder):
        return fault_runs.stopped_after(folder, next(times))[0]

    def at_an_operation(folder):
        return fault_runs.run(folder, fault="kill", n=next(numbers))[0]

    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        by_time = pool.submit(until_killed, tmp_path / "time", whole, at_a_time)
        by_operation = pool.submit(until_killed, tmp_path / "operation", whole, at_an_operation)
        saving, _ = by_operation.result()
        by_time.result()
    assert saving >= KILLS // 3


def test_every_signal_at_a_random_moment_stops_a_run_in_order(whole, seconds, tmp_path):
    rng = np.random.default_rng(1)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        folder = tmp_path / str(number)
        process = fault_runs.start(folder)
        fault_runs.wait_for(process, "folder")
        with pytest.raises(Exception, match="timed out"):
            process.wait(rng.uniform(0, seconds / 10))
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
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=100)
    assert process.returncode in (-signal.SIGTERM, 75)
    assert fault_runs.run(tmp_path / "run")[0] == 0
    fault_runs.assert_same(tmp_path / "run", whole)
