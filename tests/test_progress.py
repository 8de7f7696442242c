"""The progress display: right numbers, and never the reason a run ends."""

import io
import os
import subprocess
import sys

import numpy as np
import pytest

from crsfd_jax.progress import progress, status_line

NOISY = """
from crsfd_jax.progress import progress, say

for _ in range(5000):
    say("a line")
with progress(5000, interval_s=0.0) as update:
    for step in range(5000):
        update(step, [0.5])
open({path!r}, "w").write("finished")
"""


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_line_tells_steps_speed_time_left_and_success():
    line = status_line(12_800, 60_000, 1180.0, np.array([0.4, 0.6]))
    assert line == "12,800/60,000 steps  1,180 steps/s  left 0:00:40  success 0.50 [0.40 0.60]"


def test_what_is_not_known_yet_is_not_claimed():
    assert status_line(0, 100, 0.0, []) == "0/100 steps  0 steps/s  left unknown"


def test_plain_lines_are_spaced_in_time_and_the_last_state_is_always_shown():
    stream = io.StringIO()
    with progress(300, interval_s=60.0, stream=stream) as update:
        for step in (100, 200, 300):
            update(step, [])
    lines = stream.getvalue().splitlines()
    assert [line.split()[0] for line in lines] == ["100/300", "300/300"]


def test_steps_made_before_a_resume_do_not_count_as_speed(monkeypatch):
    clock = iter([0.0, *[10.0] * 9])
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    stream = io.StringIO()
    with progress(2000, done_steps=1000, interval_s=0.0, stream=stream) as update:
        update(1100, [])
    assert "  10 steps/s  left 0:01:30" in stream.getvalue()


def test_a_terminal_shows_the_same_line_beside_a_bar():
    stream = Terminal()
    with progress(300, stream=stream) as update:
        update(300, [1.0, 1.0])
    assert "success 1.00" in stream.getvalue()


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_reader_that_goes_away_does_not_stop_the_run(tmp_path, unbuffered):
    done = tmp_path / "done"
    command = [sys.executable, "-c", NOISY.format(path=str(done))]
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, env=environment) as run:
        assert run.stdout is not None and run.stderr is not None
        run.stdout.readline()
        run.stdout.close()
        complaint = run.stderr.read()
    assert (run.returncode, complaint) == (0, b"")
    assert done.read_text() == "finished"
