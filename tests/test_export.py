"""An exported policy is the trained one, and its side file says how to use it."""

import dataclasses
import json
import subprocess
import sys

import finished_run
import mujoco
import numpy as np
import pytest

from crsfd_jax import config, env, export, extras, task
from crsfd_jax.deploy import formats
from crsfd_jax.errors import UserError
from crsfd_jax.options import randomisation

FORMS = ("npz", "onnx", "stablehlo")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return finished_run.write(tmp_path_factory.mktemp("runs") / "made")


def needed(form):
    for module in export._NEEDS.get(form, ()):
        pytest.importorskip(module)


def expected(obs):
    """The expert's action in float64, by its first principles."""
    kernels = finished_run.expert_actor()
    hidden = obs.astype(np.float64)
    for kernel, bias in (kernels[:2], kernels[2:4]):
        hidden = np.maximum(hidden @ kernel.astype(np.float64) + bias, 0)
    return np.tanh(hidden @ kernels[4][:, :6].astype(np.float64) + kernels[5][:6])


@pytest.mark.parametrize("form", FORMS)
def test_a_policy_read_back_acts_as_the_one_that_was_made(form, run, tmp_path, capsys):
    needed(form)
    code = export.run([str(run), "--format", form, "--out", str(tmp_path / "e"), "--check"])
    said = capsys.readouterr().out
    assert code == 0 and "1000 observations" in said, said
    contract = json.loads((tmp_path / "e" / "policy.json").read_text())
    written = (tmp_path / "e" / contract["file"]).read_bytes()
    obs = np.random.default_rng(1).uniform(-2, 2, (50, 29)).astype(np.float32)
    for rows in (obs, obs[:1]):
        np.testing.assert_allclose(
            formats.FORMATS[form].read(written)(rows), expected(rows), atol=1e-5
        )


@pytest.mark.parametrize("form", FORMS)
def test_a_file_that_differs_fails_the_check(form, run, tmp_path, capsys, monkeypatch):
    needed(form)
    kind = formats.FORMATS[form]

    def spoiled(layers):
        *hidden, (weight, bias) = layers
        return kind.write([*hidden, (weight, bias + np.float32(1e-3))])

    monkeypatch.setitem(formats.FORMATS, form, kind._replace(write=spoiled))
    assert export.run([str(run), "--format", form, "--out", str(tmp_path), "--check"]) == 1
    assert "allowed 1e-05" in capsys.readouterr().out
    assert export.run([str(run), "--format", form, "--out", str(tmp_path)]) == 0


def test_an_npz_needs_numpy_only(run, tmp_path):
    export.run([str(run), "--out", str(tmp_path)])
    with np.load(tmp_path / "actor.npz", allow_pickle=False) as arrays:
        names = [f"{part}{i}" for i in range(3) for part in ("weight", "bias")]
        assert arrays.files == names
        assert arrays["weight2"].shape == (finished_run.WIDTH, 6)


def test_the_best_seed_is_exported_unless_another_is_named(run, tmp_path, capsys):
    export.run([str(run), "--out", str(tmp_path)])
    assert capsys.readouterr().out.strip().endswith("seed 4")
    export.run([str(run), "--out", str(tmp_path), "--seed", "3"])
    told = json.loads((tmp_path / "policy.json").read_text())["trained"]
    assert (told["seed"], told["success_rate"], told["env_steps"]) == (3, 0.0, 2000)
    with np.load(tmp_path / "actor.npz") as arrays:
        np.testing.assert_array_equal(arrays["weight0"], finished_run.random_actor()[0])


def test_files_lie_in_the_run_folder_unless_another_is_named(run):
    export.run([str(run)])
    assert {p.name for p in (run / "export" / "npz").iterdir()} == {"actor.npz", "policy.json"}


def test_the_contract_describes_observation_and_action(run, tmp_path, links):
    export.run([str(run), "--out", str(tmp_path)])
    told = json.loads((tmp_path / "policy.json").read_text())
    parts = told["observation"]["parts"]
    assert [(part["name"], part["size"], part["scale"]) for part in parts] == [
        ("joint_position", 7, 0.1),
        ("joint_velocity", 7, 0.5),
        ("tip_position", 3, 0.03),
        ("tip_rotation", 3, 0.1),
        ("tip_velocity", 3, 0.1),
        ("tip_angular_velocity", 3, 0.5),
        ("setpoint_error", 3, 0.01),
    ]
    assert told["observation"]["clip"] == 10 and told["rate_hz"] == 10
    rest = env.rest_posture(links)
    np.testing.assert_allclose(told["observation"]["joint_rest"], rest, atol=1e-6)
    assert told["action"]["scale"] == [0.01] * 3 + [0.05] * 3
    assert told["action"]["setpoint_low"] == [-0.04, -0.04, -0.04, -0.15, -0.15, -0.15]
    assert told["task"]["shape"] == "2" and told["task"]["clearance"] == 1e-3


def test_the_frames_of_the_contract_are_those_of_the_model(run, tmp_path):
    """A robot that knows its hand's pose has that of the tip in the frame of the observation."""
    export.run([str(run), "--out", str(tmp_path)])
    told = json.loads((tmp_path / "policy.json").read_text())["frames"]
    _, scene = task.engine("native", config.Scene())
    data, in_hand = mujoco.MjData(scene.model), np.zeros(9)
    data.qpos[:] = [0.1, 0.2, -0.1, -2.3, 0.1, 2.6, 0.8]
    mujoco.mj_forward(scene.model, data)
    base, hand, tip = data.body("link0"), data.body("hand"), data.site("tip")
    mujoco.mju_quat2Mat(in_hand, np.array(told["tip_in_hand_wxyz"]))
    turn = hand.xmat.reshape(3, 3)
    position = hand.xpos + turn @ told["tip_in_hand"]
    np.testing.assert_allclose(position, tip.xpos, atol=1e-7)
    np.testing.assert_allclose(turn @ in_hand.reshape(3, 3), tip.xmat.reshape(3, 3), atol=1e-7)
    nominal = base.xpos + np.array(told["nominal_socket_in_base"])
    np.testing.assert_allclose(base.xmat.reshape(3, 3), np.eye(3), atol=1e-12)
    observed = data.actuator_length[:3]
    np.testing.assert_allclose(position - nominal, observed, atol=1e-7)


def test_the_contract_says_what_was_drawn_in_training(run, tmp_path):
    drawn = randomisation.TRAINING
    finished_run.write(
        tmp_path / "r", dataclasses.replace(finished_run.OPTIONS, randomisation=drawn)
    )
    for source, expected in ((run, randomisation.Randomisation()), (tmp_path / "r", drawn)):
        export.run([str(source), "--out", str(tmp_path)])
        told = json.loads((tmp_path / "policy.json").read_text())["randomisation"]
        values = {k: tuple(v) if isinstance(v, list) else v for k, v in told.items()}
        assert randomisation.Randomisation(**{k: values[k] for k in vars(expected)}) == expected
        assert all(name in told["unit"] for name in vars(expected))


def test_the_controller_of_the_contract_is_the_simulated_one(run, tmp_path):
    """The force that the formula gives is the one that MuJoCo applies."""
    export.run([str(run), "--out", str(tmp_path)])
    told = json.loads((tmp_path / "policy.json").read_text())["controller"]
    _, scene = task.engine("native", config.Scene())
    data = mujoco.MjData(scene.model)
    data.qpos[:] = [0.1, 0.2, -0.1, -2.3, 0.1, 2.6, 0.8]
    data.qvel[:] = [0.02, -0.03, 0.01, 0.02, -0.01, 0.02, 0.03]
    mujoco.mj_forward(scene.model, data)
    data.ctrl[:] = data.actuator_length + np.array([5e-3, -0.1, 2e-3, 0.2, 0.01, -0.02])
    mujoco.mj_forward(scene.model, data)
    stiffness, damping, limit = (np.array(told[k]) for k in ("stiffness", "damping", "limit"))
    force = stiffness * (data.ctrl - data.actuator_length) - damping * data.actuator_velocity
    np.testing.assert_allclose(data.actuator_force, np.clip(force, -limit, limit), rtol=1e-6)
    assert (np.abs(force) > limit).any() and (np.abs(force) < limit).any()
    assert told["rate_hz"] == pytest.approx(200)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["nowhere"], "nowhere: holds no config.json"),
        (["{run}", "--seed", "9"], "--seed: got '9', allowed: best, 3, 4"),
        (["{run}", "--format", "torch"], "--format: got 'torch'"),
        (["{run}", "--out", "/dev/null/here"], "--out: got '/dev/null/here'"),
    ],
)
def test_what_cannot_be_exported_is_refused_in_one_line(arguments, told, run):
    with pytest.raises(UserError) as found:
        export.run([argument.format(run=run) for argument in arguments])
    assert str(found.value).startswith(told) and "\n" not in str(found.value)


def test_a_missing_package_is_named_with_its_extra(run, monkeypatch):
    monkeypatch.setattr(extras.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"onnxruntime.*pip install -e '\.\[onnx\]'"):
        export.run([str(run), "--format", "onnx"])


def test_a_refusal_ends_the_program_with_one_line_and_code_2(tmp_path):
    command = [sys.executable, "-m", "crsfd_jax.export", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 2
    assert ended.stderr.startswith("error: ") and ended.stderr.count("\n") == 1
