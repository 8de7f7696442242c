"""Runs the trainer under a fault: `python fault_driver.py FAULT N OPTION...`.

kill N    kill -9 at the N-th operation on a file
save1 N   kill -9 N microseconds after the first checkpoint began to be written; save2: the second
full N    the disk is full from the N-th operation on a file on
clock N   the wall clock goes back by N seconds each time that it is read
none 0    no fault
"""

import datetime
import errno
import itertools
import os
import signal
import sys
import threading
import time

from crsfd_jax import cli, free_space, train

OPERATIONS = ("fsync", "rename", "replace", "unlink", "rmdir", "mkdir")

free_space._POOL = 256  # Solving for all of the states takes longer than such a small run.


def watched(operation, number, fault):
    def act(*args, **options):
        fault(next(number))
        return operation(*args, **options)

    return act


def watch(fault):
    number = itertools.count(1)
    for name in OPERATIONS:
        setattr(os, name, watched(getattr(os, name), number, fault))


def kill_in_save(which, microseconds):
    """A checkpoint is written to a temporary folder, which is renamed once it is complete."""
    saves, mkdir = itertools.count(1), os.mkdir

    def act(path, *args, **options):
        mkdir(path, *args, **options)
        if str(path).endswith(".orbax-checkpoint-tmp") and next(saves) == which:
            threading.Timer(microseconds / 1e6, kill_now).start()

    os.mkdir = act


def kill_now():
    os.kill(os.getpid(), signal.SIGKILL)


def set_clock_back(seconds):
    readings = itertools.count()
    now, now_ns = time.time, time.time_ns
    time.time = lambda: now() - seconds * next(readings)
    time.time_ns = lambda: now_ns() - seconds * 10**9 * next(readings)

    class Backwards(datetime.datetime):
        @classmethod
        def now(cls, tz=None):
            return super().now(tz) - datetime.timedelta(seconds=seconds * next(readings))

    datetime.datetime = Backwards


def inflict(name: str, n: int) -> None:
    def kill(number):
        if number == n:
            kill_now()

    def full(number):
        if number >= n:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if name == "clock":
        set_clock_back(n)
    elif name.startswith("save"):
        kill_in_save(int(name.removeprefix("save")), n)
    elif name != "none":
        watch({"kill": kill, "full": full}[name])


if __name__ == "__main__":
    inflict(sys.argv.pop(1), int(sys.argv.pop(1)))
    cli.main(train.run)
