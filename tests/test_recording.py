"""A run's policy demonstrates: what is recorded is what it does, and replays as it was."""

import dataclasses

import finished_run
import jax
import numpy as np
import pytest

from crsfd_jax import cli, config
from crsfd_jax.algorithms.method import Preparation
from crsfd_jax.demos import __main__ as demos_command
from crsfd_jax.demos import builtin, dataset, record, recordable, replay, rollout
from crsfd_jax.demos.options import Record
from crsfd_jax.errors import UserError
from crsfd_jax.learn import networks
from crsfd_jax.options import validation
from crsfd_jax.options.randomisation import Randomisation
from crsfd_jax.storage import trained
from crsfd_jax.types import Transition


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """(demonstrations of the policy made by hand without noise, its run, the file)."""
    folder = tmp_path_factory.mktemp("recorded")
    run, file = finished_run.write(folder / "run"), folder / "new" / "demos.npz"
    line = ["from-run", str(run), "--out", str(file), "--noise", "0", "--episodes", "6"]
    assert demos_command.run(line) == 0
    return builtin.load(str(file)), run, file


def test_the_best_policy_is_recorded_with_where_it_comes_from(recorded):
    demos, _, _ = recorded
    source = demos.provenance
    assert (source.shape, source.shift_m, source.clearance_m) == ("2", 0.0, 1e-3)
    assert (source.noise, source.expert_success_rate) == (0.0, 1.0)
    assert source.expert == "crsfd on shape 2, seed 4, 2000 environment steps"
    assert dataset.episode_success(demos).all() and len(demos.episode_length) == 6


def mean_action(obs):
    """What the last layer of the policy made by hand gives before tanh, in numpy."""
    layers, x = finished_run.expert_actor(), obs.astype(float)
    for i, (kernel, bias) in enumerate(zip(layers[::2], layers[1::2], strict=True)):
        x = x @ kernel + bias
        x = np.maximum(x, 0) if i < 2 else x
    return x[:, :6]


def test_its_actions_are_those_of_the_policy(recorded):
    demos, _, _ = recorded
    np.testing.assert_allclose(demos.action, np.tanh(mean_action(demos.obs)), atol=1e-5)


def test_it_replays_to_the_same_ends(recorded):
    played = replay.replay(recorded[0], "native")
    assert played.success.all() and np.median(played.deviation) < 1e-4


def test_noise_and_a_shift_make_other_episodes(recorded):
    _, run, file = recorded
    other = file.with_name("other.npz")
    line = ["from-run", str(run), "--out", str(other), "--shift", "1mm", "--episodes", "9"]
    assert demos_command.run(line) == 0
    demos = builtin.load(str(other))
    assert demos.provenance.shift_m == 1e-3 and 0 < np.abs(demos.socket_offset).max() <= 5e-4
    policies = trained.load(run)
    actor = jax.tree.map(lambda leaf: leaf[1], policies.actors)
    _, log_std = networks.apply(policies.nets.actor, actor, demos.obs)
    inside = np.abs(demos.action) < 0.999
    unbounded = np.arctanh(np.clip(demos.action, -0.999, 0.999))
    noise = (unbounded - mean_action(demos.obs)) / np.exp(log_std)
    assert inside.sum() > 300
    for axis in range(3, 6):
        drawn = noise[inside[:, axis], axis]
        np.testing.assert_allclose([drawn.mean(), drawn.std()], [0, 1], atol=0.3)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_noise_is_a_factor_on_the_standard_deviation_of_the_policy(recorded, factor):
    _, run, file = recorded
    out = file.with_name(f"noise{factor}.npz")
    line = ["from-run", str(run), "--out", str(out), "--episodes", "40", "--noise", str(factor)]
    assert demos_command.run(line) == 0
    demos, policies = builtin.load(str(out)), trained.load(run)
    actor = jax.tree.map(lambda leaf: leaf[1], policies.actors)
    _, log_std = networks.apply(policies.nets.actor, actor, demos.obs)
    inside = np.abs(demos.action[:, 3:]) < 0.999
    unbounded = np.arctanh(np.clip(demos.action, -0.999, 0.999))
    noise = ((unbounded - mean_action(demos.obs)) / np.exp(log_std))[:, 3:]
    assert np.abs(noise[inside]).mean() == pytest.approx(factor * np.sqrt(2 / np.pi), rel=0.15)


def test_the_spread_of_a_method_that_learns_none_is_not_recorded(tmp_path):
    options = dataclasses.replace(finished_run.OPTIONS, algorithm="bc")
    run = finished_run.write(tmp_path / "run", options)
    line = ["from-run", str(run), "--out", str(tmp_path / "d.npz")]
    with pytest.raises(UserError, match="--noise: got 1, allowed with a policy of bc"):
        demos_command.run(line)
    assert demos_command.run([*line, "--noise", "0", "--episodes", "2"]) == 0


def test_episodes_that_break_down_are_left_out():
    """Of three, the second ends with neither success nor the time limit."""
    flags = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]], bool)
    steps = Transition(
        obs=np.arange(9.0).reshape(3, 3, 1),
        action=np.zeros((3, 3, 6)),
        reward=np.zeros((3, 3)),
        next_obs=np.zeros((3, 3, 1)),
        terminated=flags,
        truncated=np.zeros((3, 3), bool),
    )
    episodes = rollout.Episodes(
        steps, np.array([2, 1, 3], np.int32), np.arange(21.0).reshape(3, 7), np.zeros((3, 2))
    )
    demos = rollout.demonstrations(episodes, None)  # pyright: ignore[reportArgumentType]
    assert demos.episode_length.tolist() == [2, 3] and demos.start_qpos[:, 0].tolist() == [0, 14]
    assert demos.obs[:, 0].tolist() == [0, 3, 2, 5, 8]
    assert demos.terminated.tolist() == [False, True, False, False, True]


def test_where_the_sockets_of_demonstrations_stood_reaches_the_method(recorded):
    demos = dataclasses.replace(recorded[0].provenance, shift_m=3e-3)
    found = Preparation.of(dataclasses.replace(recorded[0], provenance=demos), lambda *_: None)
    assert found.demo_shift == 3e-3


@pytest.mark.parametrize(
    ("extra", "reason"),
    [
        (["--seed", "7"], "--seed: got '7', allowed: best, 3, 4"),
        (["--seed", "3"], "no.npz: no successful episode among 40; record with a better expert"),
        (["--shape", "all"], "--shape: got 'all', allowed: one shape"),
        (["--shape", "9"], "--shape: got '9'"),
        (["--shift", "9"], "got '9', allowed: a non-negative number with the unit"),
        (["--shift", "9cm"], "--shift: got 90mm, allowed: at least 0mm and at most 20mm"),
        (["--episodes", "0"], "--episodes: got 0"),
    ],
)
def test_a_recording_that_is_of_no_use_is_refused(recorded, extra, reason):
    _, run, file = recorded
    with pytest.raises(UserError, match=r"got|no successful") as refused:
        demos_command.run(["from-run", str(run), "--out", str(file.with_name("no.npz")), *extra])
    assert reason in str(refused.value) and not file.with_name("no.npz").exists()


def test_a_file_is_not_overwritten(recorded):
    _, run, file = recorded
    before = file.read_bytes()
    with pytest.raises(UserError, match="which exists"):
        demos_command.run(["from-run", str(run), "--out", str(file)])
    assert file.read_bytes() == before


def test_recording_is_refused_where_a_replay_could_not_follow():
    options = finished_run.OPTIONS
    assert recordable.refusal(options) == ""
    assert recordable.refusal(dataclasses.replace(options, scene=config.Scene(2e-3))) == ""
    for changed in (
        {"scene": config.Scene(footprint=0.05)},
        {"mdp": config.Mdp(translation_scale=0.02)},
        {"randomisation": Randomisation(socket_yaw=(-0.1, 0.1))},
    ):
        assert "recording needs" in recordable.refusal(dataclasses.replace(options, **changed))


def test_an_expert_of_a_shape_of_ones_own_can_be_recorded_and_of_several_cannot(tmp_path):
    (tmp_path / "bar.txt").write_text("#\n#\n")
    options = cli.parse(Record, ["--shape", str(tmp_path / "bar.txt")])
    assert record.training_options(options).shape == "bar=#/#"
    with pytest.raises(UserError, match="--shape: got '0,1', allowed: one shape"):
        demos_command.run(["record", "--shape", "0,1", "--out", str(tmp_path / "no.npz")])


def test_the_expert_learns_from_the_dense_reward_as_it_is():
    options = record.training_options(Record()).sac
    assert (options.reward_scale, options.actor_tau) == (1.0, 1.0)


def test_the_buffer_of_the_expert_holds_all_of_its_steps():
    made = record.training_options(Record(steps=100_000))
    assert made.replay.capacity == 102_400 == 20 * made.evaluation.every
    validation.validate(made)


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("--steps 10", "--sac.warmup-steps: got 2000"),
        ("--scene.clearance 8mm", "--scene.clearance: got 8mm"),
        ("--scene.friction 2", "recording needs the default footprint and friction"),
        ("--mdp.translation-scale 20mm", "recording needs the default action scales"),
    ],
)
def test_an_expert_whose_demonstrations_would_be_of_no_use_is_not_trained(tmp_path, line, answer):
    with pytest.raises(UserError, match=answer):
        demos_command.run(["record", "--out", str(tmp_path / "d.npz"), *line.split()])
    assert not list(tmp_path.iterdir())
