"""The picture of the potential: what it evaluates, and the tracks it draws."""

import dataclasses

import jax
import numpy as np
import pytest
from PIL import Image
from report_runs import cells_of, make_run

from crsfd_jax import free_space, shown_potential
from crsfd_jax.config import Config, Potential
from crsfd_jax.demos import builtin
from crsfd_jax.observation import POSE_SCALE, TIP_POSE
from crsfd_jax.report import value_map
from crsfd_jax.scene.digits import HOLE_DEPTH


def test_tracks_are_the_tips_of_the_episodes_in_metres_with_their_last_state():
    demos = builtin.load("builtin")
    tracks = shown_potential.tracks(demos)
    length = demos.episode_length
    assert tracks.shape == (len(length), length.max() + 1, 6)
    np.testing.assert_array_equal(np.isfinite(tracks[..., 0]).sum(axis=1), length + 1)
    first = length[0]
    np.testing.assert_allclose(tracks[1, 0], demos.obs[first, TIP_POSE] * POSE_SCALE)
    last = demos.next_obs[first - 1, TIP_POSE] * POSE_SCALE
    np.testing.assert_allclose(tracks[0, first], last)
    assert -HOLE_DEPTH - 1e-3 < last[2] < -HOLE_DEPTH + 2e-3, "a demonstration ends inserted"


def test_the_picture_shows_the_potential_where_its_axes_say(tmp_path, monkeypatch):
    asked, compared = [], []

    def of(width, noted):
        def phi(poses):
            noted.append(poses)
            return np.exp(-np.abs(poses[..., :3]).sum(axis=-1) / width)

        return phi

    tracks = np.zeros((2, 3, 6))
    value_map.draw(of(0.02, asked), tracks, of(0.01, compared), tmp_path / "map.png")
    assert Image.open(tmp_path / "map.png").width > 1500
    plane, cut, *lines = asked
    for own, other in zip((plane, *lines), compared, strict=True):
        np.testing.assert_array_equal(own, other)
    assert not plane[..., 2:].any() and np.ptp(plane[..., 1]) == np.ptp(plane[..., 0])
    assert not cut[..., 1].any() and not cut[..., 3:].any() and cut[..., 2].min() < -HOLE_DEPTH
    assert [int(np.flatnonzero(np.ptp(poses, axis=0))[0]) for poses in lines] == [0, 2, 3]


def test_steps_are_rewarded_where_the_discounted_potential_grows():
    tracks = np.full((2, 4, 6), np.nan)
    tracks[0, :, 2] = [0.5, 0.6, 0.6, 0.7]
    tracks[1, :2, 2] = [0.8, 0.81]
    share = value_map.rewarded(lambda poses: poses[..., 2], tracks, 0.98)
    # 0.98 times 0.6 is above 0.5, times 0.6 not above 0.6, times 0.7 is; times 0.81 is not.
    assert share == 0.5
    assert value_map.rewarded(lambda poses: poses[..., 2], tracks, 1.0) == 0.75


@pytest.mark.parametrize("gamma", [0.95, 0.5])
def test_the_potential_drawn_is_the_one_that_the_runs_learned_with(tmp_path, monkeypatch, gamma):
    fitted = []
    monkeypatch.setattr(value_map, "draw", lambda *_: None)
    monkeypatch.setattr(value_map, "rewarded", lambda *_: 0.5)
    monkeypatch.setattr(shown_potential, "fit", lambda config: (fitted.append(config), None))
    for shift in (0, 8):
        potential = Potential(gamma=gamma)
        make_run(tmp_path / f"a{shift}", shift=shift, demo_episodes=7, potential=potential)
    make_run(tmp_path / "b", "sacfd", potential=Potential(gamma=0.1))
    value_map.draw_of(cells_of(tmp_path), tmp_path / "map.png")
    config, nominal = fitted
    assert (config.demo_episodes, config.potential) == (7, Potential(gamma=gamma))
    assert config.shift == 8e-3
    moved_nowhere = dataclasses.replace(config.potential, spread=0.0)
    assert nominal == dataclasses.replace(config, potential=moved_nowhere)


def test_the_fitted_potential_rises_towards_the_end_of_the_demonstrations(monkeypatch):
    # Poses anywhere instead of those that the arm reaches, which take long to solve for.
    def sample(key, count):
        return jax.random.uniform(key, (count, 6), minval=-5.0, maxval=5.0)

    monkeypatch.setattr(free_space, "make", lambda scene, extent: sample)
    few = Potential(steps=300, hidden=(32,))
    phi, tracks = shown_potential.fit(dataclasses.replace(Config(), potential=few))
    poses = np.zeros((3, 6))
    poses[:, 2] = (-HOLE_DEPTH, 0.0, 0.14)
    inserted, mouth, above = phi(poses)
    assert inserted > mouth > above
    assert phi(np.zeros((2, 5, 6))).shape == (2, 5)
    assert len(tracks) == 40


def test_the_potential_of_an_ablation_is_that_of_its_own_options():
    options = Config(potential=Potential(steps=200))
    poses = np.array([[0.0, 0.0, 0.03, 0.0, 0.0, 0.0], [0.1, 0.0, 0.1, 0.0, 0.0, 0.0]])
    plain, _ = shown_potential.fit(options)
    arm, _ = shown_potential.fit(dataclasses.replace(options, algorithm="crsfd_no_free_space"))
    without = dataclasses.replace(options.potential, free_space_weight=0.0)
    by_hand, _ = shown_potential.fit(dataclasses.replace(options, potential=without))
    np.testing.assert_array_equal(arm(poses), by_hand(poses))
    assert (arm(poses) != plain(poses)).any()
