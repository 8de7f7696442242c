"""Learning curves and confidence intervals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageColor
from scipy.stats import binomtest

from crsfd_jax.curve import curve, mean_and_std
from crsfd_jax.drawing.learning_curve import plot
from crsfd_jax.intervals import rate_interval, wilson_interval
from crsfd_jax.storage import metrics


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        (0, 10, 0.0, 0.2775),
        (10, 10, 0.7225, 1.0),
        (15, 20, 0.5313, 0.8881),
        (81, 263, 0.2553, 0.3662),
    ],
)
def test_wilson_intervals_equal_published_numbers(successes, trials, low, high):
    # The last row is Newcombe 1998, table I, method 3.
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=6e-5)


@given(st.integers(1, 2000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_intervals_equal_those_of_scipy(counts):
    expected = binomtest(*counts).proportion_ci(0.95, method="wilson")
    assert wilson_interval(*counts) == pytest.approx((expected.low, expected.high), abs=1e-9)


@pytest.mark.parametrize("counts", [(0, 0), (-1, 5), (6, 5)])
def test_impossible_counts_are_refused(counts):
    with pytest.raises(ValueError, match="successes"):
        wilson_interval(*counts)


def test_a_curve_sorts_rows_by_step_and_seed_and_marks_what_is_missing():
    columns = {
        "env_steps": np.array([200, 100, 100]),
        "seed": np.array([7, 9, 7]),
        "loss": np.array([3.0, 2.0, 1.0]),
    }
    found = curve(columns, "loss")
    assert found.env_steps.tolist() == [100, 200]
    np.testing.assert_array_equal(found.values, [[1, 2], [3, np.nan]])


def test_mean_and_std_leave_out_seeds_without_a_value():
    values = np.array([[0.0, 1.0, np.nan], [0.3, 0.3, 0.3], [np.nan] * 3])
    mean, std = mean_and_std(values)
    np.testing.assert_allclose(mean, [0.5, 0.3, np.nan])
    np.testing.assert_allclose(std, [0.5, 0, np.nan], atol=1e-12)


@pytest.mark.parametrize("steps", [(100,), (0, 100, 200)])
def test_a_picture_of_a_run_has_a_panel_for_evaluation_and_one_for_training(tmp_path, steps):
    rates = np.random.default_rng(0).uniform(size=(2, 3, 3))
    rows = [
        {"env_steps": step, "seed": seed}
        | {f"{who}/success_rate": rates[k, i, seed] for k, who in enumerate(("eval", "train"))}
        for i, step in enumerate(steps)
        for seed in range(3)
    ]
    metrics.append(tmp_path / "metrics.csv", rows)
    plot("crsfd", tmp_path / "metrics.csv", tmp_path / "curves.png")
    picture = Image.open(tmp_path / "curves.png")
    assert picture.width > 2 * picture.height
    for left in (0, picture.width // 2):
        # Above the legend.
        half = picture.crop((left, 0, left + picture.width // 2, int(0.8 * picture.height)))
        colour = np.array(ImageColor.getrgb("#0072B2"))
        near = np.abs(np.asarray(half.convert("RGB")).astype(int) - colour).sum(axis=-1) < 40
        assert near.sum() > 50


def test_the_interval_of_several_policies_is_the_wider_one_of_trials_and_of_seeds():
    trials = np.full(5, 100)
    assert rate_interval(trials, trials) == pytest.approx(wilson_interval(500, 500))
    # t(4) at 0.975 is 2.776, the deviation of the five rates 0.1581.
    apart = rate_interval([60, 70, 80, 90, 100], trials)
    assert apart == pytest.approx((0.8 - 0.1963, 0.8 + 0.1963), abs=1e-4)
    assert rate_interval([8], [10]) == wilson_interval(8, 10)
    assert rate_interval([8, 0], [10, 0]) == wilson_interval(8, 10)
