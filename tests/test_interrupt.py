"""Signals ask a process to stop, and end it only when they are repeated."""

import signal
import subprocess
import sys
import time

import pytest

PROGRAM = """
import hashlib, signal, time
{before}
from crsfd_jax.interrupt import Interrupt
with Interrupt() as interrupt:
    print("ready", flush=True)
    {block}
print("requested" if interrupt.requested else "not requested")
"""
WAIT = """end = time.monotonic() + 3
    while not interrupt.requested and time.monotonic() < end:
        time.sleep(0.01)"""
LONG_CALL = "hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9)"
"""Lets other threads run, as a compilation does, and no handler."""


@pytest.fixture
def begun():
    """Starts a program; all are killed in the end."""
    processes = []

    def begin(block, before=""):
        program = PROGRAM.format(block=block, before=before)
        process = subprocess.Popen(
            [sys.executable, "-c", program],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        assert process.stdout.readline() == "ready\n"
        return process

    yield begin
    for process in processes:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_asks_and_the_process_goes_on(begun, number):
    process = begun(WAIT)
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert out == "requested\n" and err.startswith("stopping after this step")
    assert process.returncode == 0


def test_a_terminal_that_was_closed_is_no_fault(begun):
    process = begun(WAIT)
    process.stderr.close()
    process.send_signal(signal.SIGHUP)
    assert process.stdout.read() == "requested\n" and process.wait(30) == 0


def test_what_was_ignored_stays_ignored(begun):
    process = begun(WAIT, "signal.signal(signal.SIGHUP, signal.SIG_IGN)")
    process.send_signal(signal.SIGHUP)
    assert process.communicate(timeout=30)[0] == "not requested\n"


def test_the_same_signal_from_two_sides_asks_once_and_a_later_one_ends_the_process(begun):
    process = begun(LONG_CALL)
    for _ in range(2):
        process.send_signal(signal.SIGTERM)
        time.sleep(0.2)
    assert process.poll() is None
    assert process.stderr.readline().startswith("stopping after this step")
    time.sleep(1.2)
    process.send_signal(signal.SIGINT)
    assert process.wait(10) == 128 + signal.SIGINT


def test_handlers_are_as_before_afterwards():
    from crsfd_jax.interrupt import Interrupt

    before = signal.getsignal(signal.SIGTERM), signal.set_wakeup_fd(-1)
    signal.set_wakeup_fd(before[1])
    with Interrupt() as interrupt:
        assert signal.getsignal(signal.SIGTERM) != before[0]
    after = signal.set_wakeup_fd(-1)
    signal.set_wakeup_fd(after)
    assert (signal.getsignal(signal.SIGTERM), after) == before and not interrupt.requested
