"""What a bench adds up, by runs whose time is known."""

import sys
from pathlib import Path

import pytest
import script

from crsfd_jax.sweeps.attempt import Plan

HERE = Path(__file__).parent


@pytest.fixture
def workers():
    return script.load(HERE.parent / "bench" / "workers.py")


def test_steps_of_all_seeds_of_all_workers_count(workers, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_STEP_S", "0")
    plan = Plan(tmp_path, (sys.executable, str(HERE / "fake_train.py")), retries=0)
    # Whatever is asked for, each cell says that it took 40.96 s.
    rate = workers.steps_per_second(2, plan)
    assert rate == pytest.approx(2 * 5 * workers.STEPS / 40.96)


def test_a_run_that_fails_is_told(workers, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_FAIL", "worker0 usage")
    plan = Plan(tmp_path, (sys.executable, str(HERE / "fake_train.py")), retries=0)
    with pytest.raises(RuntimeError, match="worker0: failed"):
        workers.steps_per_second(1, plan)
