"""Demonstrations do again in the simulator what their file says, or the replay says that not."""

import dataclasses
from importlib import resources

import numpy as np
import pytest

from crsfd_jax import env
from crsfd_jax.demos import dataset, replay
from crsfd_jax.errors import UserError
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE

KEPT = 6


@pytest.fixture(scope="module")
def shipped():
    folder = resources.files("crsfd_jax.demos")
    return dataset.load(str(folder / "shape0.npz"), OBS_SIZE, ACTION_SIZE)


@pytest.fixture(scope="module")
def few(shipped):
    """The first episodes only, so that a replay costs little."""
    steps = shipped.episode_length[:KEPT].sum()
    names = ("obs", "action", "reward", "next_obs", "terminated", "truncated")
    first = {name: getattr(shipped, name)[:steps] for name in names}
    per_episode = {n: getattr(shipped, n)[:KEPT] for n in ("episode_length", "start_qpos")}
    return dataclasses.replace(
        shipped, **first, **per_episode, socket_offset=shipped.socket_offset[:KEPT]
    )


@pytest.fixture(scope="module")
def played(shipped):
    return replay.replay(shipped, "native")


def test_the_shipped_demonstrations_replay_to_the_same_ends(shipped, played):
    np.testing.assert_array_equal(played.success, played.recorded_success)
    np.testing.assert_array_equal(played.recorded_success, dataset.episode_success(shipped))
    assert played.recorded_success.mean() >= 0.5 and len(played.success) == 40
    # Other instruction sets round differently, and a sliding contact lets that grow.
    assert np.median(played.deviation) < 1e-4 and played.deviation.max() < 2e-3


def test_an_episode_replays_alone_as_among_others(few, played):
    alone = replay.replay(few, "native")
    np.testing.assert_array_equal(alone.success, played.success[:KEPT])
    np.testing.assert_allclose(alone.deviation, played.deviation[:KEPT], atol=1e-4)


def test_other_actions_lead_elsewhere(few):
    played = replay.replay(dataclasses.replace(few, action=-few.action), "native")
    assert not played.success.any()
    assert (played.deviation > 0.01).all()


def test_a_socket_in_another_place_is_not_found(few):
    moved = few.socket_offset + np.float32(5e-3)
    played = replay.replay(dataclasses.replace(few, socket_offset=moved), "native")
    assert played.recorded_success.any() and not played.success.any()


def test_a_start_in_another_place_shows_in_the_deviation(few):
    other = np.roll(few.start_qpos, 1, axis=0)
    played = replay.replay(dataclasses.replace(few, start_qpos=other), "native")
    assert (played.deviation > 2e-3).all()


def test_what_the_arm_does_after_an_episode_does_not_count(shipped, played):
    """Each episode is cut before its last step; some pegs would then coast into their holes."""
    kept = np.delete(np.arange(len(shipped.obs)), np.cumsum(shipped.episode_length) - 1)
    names = ("obs", "action", "reward", "next_obs", "terminated", "truncated")
    cut = {name: getattr(shipped, name)[kept] for name in names}
    length = shipped.episode_length - np.int32(1)
    early = replay.replay(dataclasses.replace(shipped, **cut, episode_length=length), "native")
    assert not early.success.any() and not early.recorded_success.any()
    assert (early.deviation <= played.deviation + 1e-4).all()


def test_another_action_scale_is_refused(few):
    scale = [0.02] * 3 + [0.05] * 3
    other = dataclasses.replace(few.provenance, action_scale=scale)
    with pytest.raises(UserError, match=r"action scale .*0\.02"):
        replay.replay(dataclasses.replace(few, provenance=other), "native")


def test_a_shape_in_another_file_is_refused(few, tmp_path):
    (tmp_path / "plus.txt").write_text(".#.\n###\n.#.\n")
    source = dataclasses.replace(few.provenance, shape=str(tmp_path / "plus.txt"))
    with pytest.raises(UserError, match=r"plus\.txt', a file, expected a digit or a grid itself"):
        replay.replay(dataclasses.replace(few, provenance=source), "native")


def test_an_episode_that_ends_a_step_early_does_not_go_on_as_another(few, monkeypatch):
    monkeypatch.setattr(env, "SUCCESS_DEPTH", 0.025)
    played = replay.replay(few, "native")
    assert played.success.all() and played.deviation.max() < 2e-3


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"shape": "9"}, "provenance.shape: got '9'"),
        ({"shape": "0,2"}, "provenance.shape: got 2 shapes, expected one"),
        ({"clearance_m": 0.05}, "provenance.clearance_m: --scene.clearance: got 50mm"),
        ({"clearance_m": -1e-3}, "provenance.clearance_m: --scene.clearance: got -1mm"),
    ],
)
def test_a_peg_that_cannot_be_is_refused(few, changed, reason):
    source = dataclasses.replace(few.provenance, **changed)
    with pytest.raises(UserError) as error:
        replay.replay(dataclasses.replace(few, provenance=source), "native")
    assert reason in str(error.value) and "\n" not in str(error.value)


def test_columns_in_another_unit_are_refused(few):
    columns = [list(column) for column in few.provenance.obs_layout]
    columns[3][1] = columns[3][1].replace("0.1", "5")
    source = dataclasses.replace(few.provenance, obs_layout=columns)
    with pytest.raises(UserError, match=r"hold joint_position_3 .*divided by 5.* where .*by 0.1"):
        replay.replay(dataclasses.replace(few, provenance=source), "native")
