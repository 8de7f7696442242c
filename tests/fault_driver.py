"""Runs the trainer under a fault: `python fault_driver.py FAULT N OPTION...`.

kill N    kill -9 at the N-th operation on a file
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
import time

from crsfd_jax import cli, train

OPERATIONS = ("fsync", "rename", "replace", "unlink", "rmdir", "mkdir")


def watched(operation, number, fault):
    def act(*args, **options):
        fault(next(number))
        return operation(*args, **options)

    return act


def watch(fault):
    number = itertools.count(1)
    for name in OPERATIONS:
        setattr(os, name, watched(getattr(os, name), number, fault))


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
            os.kill(os.getpid(), signal.SIGKILL)

    def full(number):
        if number >= n:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if name == "clock":
        set_clock_back(n)
    elif name != "none":
        watch({"kill": kill, "full": full}[name])


if __name__ == "__main__":
    inflict(sys.argv.pop(1), int(sys.argv.pop(1)))
    cli.main(train.run)
