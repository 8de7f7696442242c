"""The example control loop does on a simulated arm what the training environment does."""

import subprocess
import sys
from pathlib import Path

import finished_run
import jax
import numpy as np
import pytest
import script

from crsfd_jax import evaluation, export, task
from crsfd_jax.errors import UserError
from crsfd_jax.intervals import wilson_interval
from crsfd_jax.storage import trained

REAL_ARM = Path(__file__).parents[1] / "experiments" / "real_arm"
EPISODES = 20


@pytest.fixture(scope="module")
def loop():
    return imported("control_loop")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    made = finished_run.write(tmp_path_factory.mktemp("runs") / "made")
    for seed in ("3", "4"):
        export.run([str(made), "--seed", seed, "--out", str(made / seed)])
    return made


@pytest.fixture(scope="module")
def arm(loop, run):
    return imported("simulated_arm").SimulatedArm(loop.load(run / "3")[0])


def imported(name):
    return script.load(REAL_ARM / f"{name}.py")


class Recorder:
    """A robot that also notes where its tip was."""

    def __init__(self, arm, places):
        self.arm, self.hold, self.places = arm, arm.hold, places

    def read(self):
        given = self.arm.read()
        self.places.append(given[2][:3, 3] - self.arm.scene.nominal)
        return given


class Unmoved:
    """A robot that must not be told to go anywhere."""

    def __init__(self, arm):
        self.arm = arm

    def hold(self, pose):
        raise AssertionError(f"moved to {pose}")


@pytest.mark.parametrize("seed", ["3", "4"])
def test_the_tip_goes_where_the_environment_takes_it(seed, loop, run, arm):
    """Two independent ways from the same start: observation, policy and setpoint must agree."""
    contract, layers = loop.load(run / seed)
    places = []
    arm.restart(7)
    env, (_, nets, actors) = task.make_env(finished_run.OPTIONS), trained.load(run)
    actor = jax.tree.map(lambda leaf: leaf[int(seed) - 3], actors)
    state, expected = arm.state, []
    advance = jax.jit(lambda s: env.advance(s, evaluation.mode_action(nets.actor, actor, s.obs))[0])
    loop.insert(Recorder(arm, places), contract, layers)
    for _ in places:
        expected.append(np.asarray(state.tip[0, :3]))
        state = advance(state)
    # Where the peg is in the hole, rounding is amplified by contact; it is 1 mm wide.
    np.testing.assert_allclose(places, expected, atol=5e-4)
    np.testing.assert_allclose(places[:8], expected[:8], atol=1e-5)


def test_it_inserts_as_often_as_the_evaluation_says(loop, run, arm):
    contract, layers = loop.load(run / "4")
    ended, true = [], []
    for seed in range(EPISODES):
        arm.restart(seed)
        ended.append(loop.insert(arm, contract, layers))
        true.append(arm.is_inserted())
    assert ended == true, "the loop is wrong about success"
    env, (_, nets, actors) = task.make_env(finished_run.OPTIONS), trained.load(run)
    actor = jax.tree.map(lambda leaf: leaf[1], actors)
    play = jax.jit(lambda key: evaluation.run(env, nets, actor, key, 200).success)
    rate = float(np.mean(play(jax.random.key(0))))
    low, high = wilson_interval(sum(true), EPISODES)
    assert rate > 0.9 and low <= rate <= high


def test_a_policy_that_wanders_does_not_insert(loop, run, arm):
    arm.restart(0)
    assert loop.insert(arm, *loop.load(run / "3")) is False


def test_a_tip_outside_the_workspace_stops_the_loop(loop, run, arm):
    arm.restart(0)

    class Lost(Unmoved):
        def read(self):
            q, dq, pose, twist = self.arm.read()
            return q, dq, pose + far, twist

    for place in (0.3, np.nan):
        far = np.zeros((4, 4))
        far[0, 3] = place
        with pytest.raises(RuntimeError, match="left the workspace"):
            loop.insert(Lost(arm), *loop.load(run / "4"))


@pytest.mark.parametrize("which", range(3))
def test_a_reading_that_is_not_finite_stops_the_loop(loop, run, arm, which):
    arm.restart(0)

    class Broken(Unmoved):
        def read(self):
            q, dq, pose, twist = (np.array(part) for part in self.arm.read())
            (q, dq, twist)[which][2] = np.nan
            return q, dq, pose, twist

    with pytest.raises(RuntimeError, match="is not known"):
        loop.insert(Broken(arm), *loop.load(run / "4"))


def test_rotation_vectors_and_pose_matrices_are_inverse(loop):
    for vector in ([0.1, -0.2, 0.05], [0, 0, 0], [0, 0, 1e-7], [0.5, 1.0, -2.0]):
        pose = loop.pose_matrix(np.arange(3.0), np.array(vector))
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(loop.rotation_vector(pose[:3, :3]), vector, atol=1e-8)
        np.testing.assert_array_equal(pose[:, 3], [0, 1, 2, 1])


def test_what_is_no_exported_policy_is_refused(run, tmp_path):
    play = imported("simulated_arm").main
    for folder, content in ((tmp_path / "none", None), (tmp_path / "cut", '{"file"')):
        if content:
            folder.mkdir()
            (folder / "policy.json").write_text(content)
        with pytest.raises(UserError, match="holds no policy that can be read"):
            play([str(folder), "1"])
    pytest.importorskip("onnx")
    export.run([str(run), "--format", "onnx", "--out", str(tmp_path / "onnx")])
    with pytest.raises(UserError, match="--format npz"):
        play([str(tmp_path / "onnx"), "1"])


def test_the_loop_is_short_and_needs_numpy_only():
    path = REAL_ARM / "control_loop.py"
    assert len(path.read_text().splitlines()) <= 60
    code = f"import sys; sys.path.insert(0, {str(REAL_ARM)!r}); import control_loop; "
    code += "print([m for m in ('jax', 'mujoco', 'crsfd_jax', 'scipy') if m in sys.modules])"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ran.stdout.strip() == "[]", ran.stderr
