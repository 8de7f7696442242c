"""A run over several devices and processes is the run on one of them, seed by seed."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import fault_runs
import numpy as np
import pytest

from crsfd_jax.errors import UserError
from crsfd_jax.storage import metrics
from crsfd_jax.training import devices

SCRIPT = Path(__file__).with_name("probe_run.py")
SHARES = """
import jax
from crsfd_jax.training import devices
print([devices.mesh(seeds).size for seeds in (1, 2, 4, 5, 6, 8, 9)])
"""


def environment(devices=1, **more):
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={devices}"
    return os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"} | more


def start(folder, seeds, *options, **changes):
    words = [sys.executable, SCRIPT, folder, seeds, *options]
    return subprocess.Popen(
        list(map(str, words)),
        env=environment(**changes),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def run(folder, seeds, *options, **changes):
    process = start(folder, seeds, *options, **changes)
    out, _ = process.communicate(timeout=500)
    return process.returncode, out


def start_two(folder, seeds, *options):
    with socket.socket() as free:
        free.bind(("localhost", 0))
        address = f"localhost:{free.getsockname()[1]}"
    return [
        start(
            folder,
            seeds,
            *options,
            JAX_COORDINATOR_ADDRESS=address,
            JAX_NUM_PROCESSES="2",
            JAX_PROCESS_ID=str(number),
        )
        for number in range(2)
    ]


def results(folder, seeds):
    """Rows and parameters of the first seeds, without the clock."""
    table = metrics.read(folder / "metrics.csv")
    own = table["seed"] < seeds
    columns = {n: c[own] for n, c in table.items() if n not in metrics.WALL_CLOCK_COLUMNS}
    with np.load(folder / "policy.npz") as file:
        return columns | {name: file[name][:seeds] for name in file.files}


def assert_equal(one, other):
    """Equal but for the order of float32 sums, which differs with the program that is compiled."""
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_allclose(one[name], other[name], rtol=2e-4, atol=2e-5, err_msg=name)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """Where `on_two` keeps what it compiles."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def on_two(tmp_path_factory, cache):
    """A run of four seeds on two devices."""
    folder = tmp_path_factory.mktemp("two") / "run"
    code, out = run(folder, 4, devices=2, JAX_COMPILATION_CACHE_DIR=str(cache))
    assert code == 0, out
    assert "seeds     4, evenly on 2 of 2 devices, 1 processes" in out
    return folder


def test_each_device_computes_what_it_would_compute_alone(on_two, tmp_path):
    code, out = run(tmp_path / "run", 2)
    assert code == 0, out
    assert_equal(results(on_two, 2), results(tmp_path / "run", 2))


def test_the_next_run_of_a_kind_compiles_nothing(on_two, cache, tmp_path):
    compiled = {path.name for path in cache.glob("*-cache")}
    code, out = run(tmp_path / "run", 4, devices=2, JAX_COMPILATION_CACHE_DIR=str(cache))
    assert code == 0, out
    assert {name.split("-")[0] for name in compiled} >= {"jit_begin", "jit_run", "jit_play"}
    assert {path.name for path in cache.glob("*-cache")} == compiled


def test_a_run_goes_on_with_another_number_of_devices(on_two, tmp_path):
    code, out = run(shutil.copytree(on_two, tmp_path / "run"), 4, 1280)
    assert code == 0, out
    assert "resumed at 1024 of 1280 steps" in out and "not bit-equal" in out


def test_the_devices_that_share_the_seeds_evenly_are_used():
    done = subprocess.run(
        [sys.executable, "-c", SHARES],
        env=environment(devices=4),
        capture_output=True,
        text=True,
        check=True,
        timeout=100,
    )
    assert json.loads(done.stdout) == [1, 2, 4, 1, 3, 4, 3]


@pytest.mark.parametrize(("number", "own"), [("", "0"), ("2", ""), ("2", "2"), ("two", "0")])
def test_processes_that_are_named_in_part_are_refused(monkeypatch, number, own):
    monkeypatch.setenv("JAX_COORDINATOR_ADDRESS", "localhost:1")
    monkeypatch.setenv("JAX_NUM_PROCESSES", number)
    monkeypatch.setenv("JAX_PROCESS_ID", own)
    with pytest.raises(UserError, match=r"JAX_NUM_PROCESSES and JAX_PROCESS_ID: got"):
        devices.join()


@pytest.mark.faults
def test_two_processes_compute_what_two_devices_of_one_do(on_two, tmp_path):
    processes = start_two(tmp_path / "run", 4)
    outs = [process.communicate(timeout=500)[0] for process in processes]
    assert [process.returncode for process in processes] == [0, 0], outs
    assert "4, evenly on 2 of 2 devices, 2 processes" in outs[0] and "final" not in outs[1]
    assert_equal(results(on_two, 4), results(tmp_path / "run", 4))


@pytest.mark.faults
def test_two_processes_go_on_where_they_stopped(on_two, tmp_path):
    folders = f"{tmp_path / 'a'},{tmp_path / 'b'}"
    for steps, said in ((512, "prepared"), (1024, "resumed at 512")):
        processes = start_two(folders, 2, steps)
        outs = [process.communicate(timeout=500)[0] for process in processes]
        assert [process.returncode for process in processes] == [0, 0], outs
        assert said in outs[0]
    assert_equal(results(on_two, 2), results(tmp_path / "a", 2))


@pytest.mark.faults
def test_a_signal_to_any_process_stops_all_and_one_can_go_on_alone(on_two, tmp_path):
    processes = start_two(tmp_path / "run", 4)
    fault_runs.wait_for(processes[0], "compiled")
    processes[1].send_signal(signal.SIGTERM)
    outs = [process.communicate(timeout=500)[0] for process in processes]
    assert [process.returncode for process in processes] == [75, 75], outs
    code, out = run(tmp_path / "run", 4, devices=2)
    assert code == 0, out
    assert "resumed at" in out
    assert_equal(results(on_two, 4), results(tmp_path / "run", 4))
