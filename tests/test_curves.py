"""Learning curves and confidence intervals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.stats import binomtest

from crsfd_jax import metrics
from crsfd_jax.errors import UserError
from crsfd_jax.intervals import wilson_interval
from crsfd_jax.report.curves import curve, mean_and_spread, plot


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


def rows(name="eval/success_rate", seeds=3, steps=(0, 100, 200)):
    rates = np.random.default_rng(0).uniform(size=(len(steps), seeds))
    return [
        {"env_steps": step, "seed": seed, name: rates[i, seed]}
        for i, step in enumerate(steps)
        for seed in range(seeds)
    ]


def test_a_curve_sorts_rows_by_step_and_seed_and_marks_what_is_missing():
    columns = {
        "env_steps": np.array([200, 100, 100]),
        "seed": np.array([7, 9, 7]),
        "loss": np.array([3.0, 2.0, 1.0]),
    }
    found = curve(columns, "loss")
    assert found.env_steps.tolist() == [100, 200]
    np.testing.assert_array_equal(found.values, [[1, 2], [3, np.nan]])


def test_mean_and_spread_leave_out_seeds_without_a_value():
    values = np.array([[0.0, 1.0, np.nan], [0.3, 0.3, 0.3], [np.nan] * 3])
    mean, spread = mean_and_spread(values)
    np.testing.assert_allclose(mean, [0.5, 0.3, np.nan])
    np.testing.assert_allclose(spread, [0.5, 0, np.nan], atol=1e-12)


def test_a_picture_is_drawn_for_one_run_and_for_several(tmp_path):
    metrics.append(tmp_path / "a.csv", rows())
    metrics.append(tmp_path / "b.csv", rows("train/success_rate", seeds=1, steps=(50,)))
    plot({"a": tmp_path / "a.csv"}, tmp_path / "new" / "one.png")
    plot({"a": tmp_path / "a.csv", "b": tmp_path / "b.csv"}, tmp_path / "two.png")
    one, two = Image.open(tmp_path / "new" / "one.png"), Image.open(tmp_path / "two.png")
    assert two.width == 2 * one.width
    assert len(one.convert("RGB").getcolors(1 << 20)) > 20


def test_runs_without_an_evaluation_are_refused_by_name(tmp_path):
    metrics.append(tmp_path / "a.csv", rows())
    metrics.truncate(tmp_path / "a.csv", -1)
    with pytest.raises(UserError, match=r"a.csv: holds no evaluation"):
        plot({"a": tmp_path / "a.csv"}, tmp_path / "a.png")
    metrics.append(tmp_path / "b.csv", rows("loss"))
    with pytest.raises(UserError, match="none of eval/success_rate"):
        plot({"b": tmp_path / "b.csv"}, tmp_path / "b.png")
    assert not (tmp_path / "a.png").exists()
