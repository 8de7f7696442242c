"""The doctor tells the truth about this machine, quickly and without failing."""

import itertools
import json
from importlib import metadata
from typing import NamedTuple

import jax
import jax.numpy as jnp
import pytest

from crsfd_jax import checkup, config, doctor
from crsfd_jax.drawing import opengl
from crsfd_jax.env import Env
from crsfd_jax.errors import UserError

SPEEDS = {64: 950.0, 256: 1000.0}


@pytest.fixture
def quick(monkeypatch):
    """No simulator is run: the speed depends on the number of environments only."""
    asked = []

    def measure(engine, count, seconds):
        asked.append((engine, count, seconds))
        return SPEEDS[count // checkup.SEEDS]

    monkeypatch.setattr(checkup, "steps_per_second", measure)
    return asked


def test_the_json_report_is_one_line_of_what_is_here(quick, capsys):
    doctor.main(["--json", "--engines", "native", "--seconds", "3"])
    text = capsys.readouterr().out
    assert text.count("\n") == 1
    report = json.loads(text)
    assert report["versions"]["jax"] == metadata.version("jax")
    assert [rate["envs"] for rate in report["engines"]] == list(SPEEDS)
    assert [rate["steps_per_s"] for rate in report["engines"]] == list(SPEEDS.values())
    assert quick == [("native", 5 * envs, 1.5) for envs in SPEEDS]
    assert report["suggested_envs"] == 64
    assert report["devices"] and report["compile_cache"]["bytes"] >= 0


def test_the_table_names_every_topic(quick, capsys):
    doctor.main(["--engines", "native"])
    text = capsys.readouterr().out
    for word in ("versions", "devices", "OpenGL", "compile cache", "--envs", "extras", "steps/s"):
        assert word in text
    for extra in json.loads(_json(capsys))["extras"].values():
        assert not extra["missing"] or extra["install"] in text, "a command is cut or changed"


def _json(capsys) -> str:
    doctor.main(["--json", "--engines", "native"])
    return capsys.readouterr().out


def test_the_fewest_environments_that_are_nearly_as_fast_are_suggested():
    def rates(*speeds):
        sizes = zip((16, 64, 256), speeds, strict=True)
        return [{"envs": envs, "steps_per_s": speed} for envs, speed in sizes]

    assert checkup.suggested_envs(rates(10, 20, 30)) == 256
    assert checkup.suggested_envs(rates(29, 20, 30)) == 16
    assert checkup.suggested_envs([]) == config.Config.envs


def test_a_missing_package_comes_with_the_command_that_brings_it(monkeypatch):
    inner = {"jax": ["no-such-plugin; extra == 'cuda13'", "nor-this; extra == 'tpu'"], "numpy": []}

    def requires(name):
        if name not in inner:
            raise checkup.metadata.PackageNotFoundError
        return inner[name]

    monkeypatch.setattr(checkup.metadata, "requires", requires)
    found = checkup._extras(
        [
            "numpy>=2",
            "no-such-package>=1; extra == 'view'",
            'numpy>=2; extra == "view"',
            "jax[cuda13]; extra == 'cuda'",
        ]
    )
    assert found["view"] == {
        "missing": ["no-such-package"],
        "install": "pip install -e '.[view]'",
    }
    assert set(found) == {"view", "cuda"}
    assert found["cuda"]["missing"] == ["no-such-plugin"]


def test_a_machine_that_cannot_draw_is_told_so_and_nothing_fails(quick, monkeypatch, capsys):
    def broken():
        raise UserError("OpenGL: got none that works; install a software renderer")

    monkeypatch.setattr(opengl, "platform", broken)
    doctor.main(["--json", "--engines", "native"])
    report = json.loads(capsys.readouterr().out)
    assert report["opengl"] == {
        "works": False,
        "problem": "OpenGL: got none that works; install a software renderer",
    }


def test_an_engine_that_cannot_run_here_is_a_line_and_not_a_failure(quick, monkeypatch, capsys):
    def refuse(name):
        if name == "warp":
            raise UserError("--engine: got 'warp'; install it first")
        return "native"

    monkeypatch.setattr(checkup.select, "resolve", refuse)
    doctor.main(["--json", "--engines", "warp", "native"])
    report = json.loads(capsys.readouterr().out)
    assert list(report["engine_problems"]) == ["warp"] and report["suggested_envs"] == 64


class Ages(NamedTuple):
    age: jax.Array


def test_the_speed_counts_every_step_of_every_environment(monkeypatch):
    """A clock that advances by a second at each look, and an environment that does nothing."""
    fake = Env(
        reset=lambda key, count: Ages(jnp.zeros(count, jnp.int32)),
        step=lambda state, action, key: (Ages(state.age + 1), None),
        advance=None,
        horizon=50,
    )
    looks = itertools.count()
    monkeypatch.setattr(checkup.task, "make_env", lambda options: fake)
    monkeypatch.setattr(checkup.time, "perf_counter", lambda: float(next(looks)))
    speed = checkup.steps_per_second("native", 6, 3.0)
    # Looks: start 0; 1, 2 and 3 end calls; 4 ends the measurement.
    assert speed == 3 * 6 * checkup._STEPS / 4
