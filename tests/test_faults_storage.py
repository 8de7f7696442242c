"""Disks, memory and clocks that fail: one line, the right exit code, and nothing is lost."""

import os
import resource
import shutil
import signal
import subprocess
from pathlib import Path

import fault_runs
import numpy as np
import pytest

pytestmark = pytest.mark.faults


@pytest.fixture(scope="module")
def half(tmp_path_factory) -> Path:
    """A run that was stopped after its first steps; copy it before use."""
    folder = tmp_path_factory.mktemp("half") / "run"
    process = fault_runs.start(folder)
    fault_runs.wait_for(process, "compiled")
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=500)
    assert process.returncode == 75
    return folder


@pytest.fixture
def stopped(half, tmp_path) -> Path:
    return shutil.copytree(half, tmp_path / "run")


def only_error(out: str) -> str:
    """The last line, which is the only one about an error."""
    assert "Traceback" not in out
    lines = [line for line in out.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1 and out.splitlines()[-1] == lines[0], out
    return lines[0]


def checkpoints(folder: Path) -> dict[str, bytes]:
    paths = sorted((folder / "checkpoints").rglob("*"))
    return {str(p.relative_to(folder)): p.read_bytes() for p in paths if p.is_file()}


def test_files_that_may_not_grow_stop_a_run_that_goes_on_when_they_may(stopped, whole):
    before = checkpoints(stopped)
    limit = (200_000, 200_000)
    code, out = fault_runs.run(
        stopped, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    )
    assert code == 75, out
    assert "cannot be written" in only_error(out) and "run the same command again" in out
    assert checkpoints(stopped) == before
    assert fault_runs.run(stopped)[0] == 0
    fault_runs.assert_same(stopped, whole)


def test_a_disk_that_fills_up_at_any_moment_stops_a_run_that_goes_on_later(whole, tmp_path):
    for trial, n in enumerate(np.random.default_rng(2).integers(1, 60, 6)):
        folder = tmp_path / str(trial)
        code, out = fault_runs.run(folder, fault="full", n=n)
        assert code == (75 if "compiling" in out else 2), out
        assert "o space left" in only_error(out)
    for trial in range(6):
        folder = tmp_path / str(trial)
        code, out = fault_runs.run(folder)
        assert code == 0, out
        fault_runs.assert_same(folder, whole)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount")
def test_a_small_disk_that_is_full_stops_a_run_that_goes_on_with_more_room(half, whole, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    size = sum(path.stat().st_size for path in half.rglob("*"))
    mount = ["mount", "-t", "tmpfs", "-o", f"size={8 * size}", "tmpfs", disk]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting is not allowed here")
    try:
        process = fault_runs.start(disk / "run")
        fault_runs.wait_for(process, "compiling")
        ballast = disk / "ballast"
        left = shutil.disk_usage(disk).free - size // 2
        ballast.write_bytes(bytes(left))
        out, _ = process.communicate(timeout=500)
        assert process.returncode == 75, out
        assert "o space left" in only_error(out)
        ballast.unlink()
        assert fault_runs.run(disk / "run")[0] == 0
        fault_runs.assert_same(disk / "run", whole)
    finally:
        subprocess.run(["umount", disk], check=True)


def test_a_folder_that_may_not_be_written_is_refused_before_anything_is_compiled(tmp_path):
    tmp_path.chmod(0o555)
    try:
        code, out = fault_runs.run(tmp_path / "run", preexec_fn=fault_runs.respect_permissions)
    finally:
        tmp_path.chmod(0o755)
    assert code == 2, out
    assert "cannot be written: Permission denied" in only_error(out)
    assert "compil" not in out


def test_a_run_without_memory_ends_in_one_line(tmp_path):
    if shutil.disk_usage(tmp_path).free < 16 * 2**30:
        pytest.skip("a disk with less than 16 GiB free is refused before memory is asked for")
    gigabytes = 6 * 2**30
    code, out = fault_runs.run(
        tmp_path / "run",
        *("--no-smoke", "--replay.capacity", 64 * 60_000, "--steps", 64 * 60_000),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (gigabytes, gigabytes)),
    )
    assert code == 2, out
    assert "out of memory" in only_error(out)


def test_a_clock_that_goes_back_changes_nothing(stopped, whole):
    code, out = fault_runs.run(stopped, fault="clock", n=86_400)
    assert code == 0, out
    fault_runs.assert_same(stopped, whole)


def test_a_run_goes_on_with_another_engine_and_says_that_it_is_no_longer_bit_equal(
    half, stopped, tmp_path
):
    twin = shutil.copytree(half, tmp_path / "twin")
    for folder in (stopped, twin):
        code, out = fault_runs.run(folder, "--engine", "mjx")
        assert code == 0, out
        assert "not bit-equal from here on" in out and "engine mjx" in out
        assert "resumed at" in out
    fault_runs.assert_same(stopped, twin)


def test_the_same_command_gives_the_same_run(whole, tmp_path):
    code, out = fault_runs.run(tmp_path / "run")
    assert code == 0, out
    fault_runs.assert_same(tmp_path / "run", whole)
