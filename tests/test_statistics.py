"""Numbers that compare runs, against scipy, closed forms and numbers worked out by hand."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import mannwhitneyu, trim_mean

from crsfd_jax.report import statistics

NAN = np.nan
rates = st.lists(st.integers(0, 50).map(lambda n: n / 50), min_size=1, max_size=12).map(np.array)


def column(*values):
    return np.array(values, float)[:, None]


@pytest.mark.parametrize(
    ("steps", "values", "expected"),
    [
        ([10], [1], 0.5),
        ([0, 10], [1, 1], 1.0),
        ([5, 10], [1, 1], 0.75),
        ([5, 10], [0, 1], 0.25),
        ([2, 4, 10], [0.5, 0.5, 0.5], 0.45),
        ([4, 6, 10], [0, NAN, 1], 0.3),
        ([4, 10], [1, NAN], 0.5),
        ([0], [0.7], 0.7),
    ],
)
def test_areas_equal_those_worked_out_by_hand(steps, values, expected):
    found = statistics.area(np.array(steps), column(*values))
    np.testing.assert_allclose(found, [expected])


def test_the_area_does_not_depend_on_the_unit_of_steps():
    values = np.random.default_rng(0).uniform(size=(6, 3))
    steps = np.arange(1, 7)
    np.testing.assert_allclose(
        statistics.area(steps, values), statistics.area(1000 * steps, values)
    )


def test_final_success_is_the_mean_of_the_last_tenth_of_each_seeds_own_steps():
    steps = np.arange(10, 210, 10)
    values = np.tile(np.arange(20.0)[:, None], (1, 2))
    values[10:, 1] = NAN
    # Seed 0: evaluations at 180, 190, 200. Seed 1 ends at 100: those at 90 and 100.
    np.testing.assert_allclose(statistics.final(steps, values), [18, 8.5])
    assert np.isnan(statistics.final(steps, np.full((20, 1), NAN)))


def test_the_first_evaluation_at_a_level_is_found_and_never_is_infinite():
    steps, values = np.array([10, 20, 30]), np.array([0.2, 0.9, 0.8])
    assert statistics.first_at(steps, values, 0.9) == 20
    assert statistics.first_at(steps, values, 0.91) == np.inf
    assert statistics.first_at(steps, np.array([NAN, 0.1, 1.0]), 0.9) == 30


@settings(deadline=None)
@given(rates)
def test_interquartile_means_equal_those_of_scipy(scores):
    assert statistics.interquartile_mean(scores) == pytest.approx(trim_mean(scores, 0.25))


@settings(max_examples=30, deadline=None)
@given(rates, rates)
def test_the_chance_of_improvement_is_the_u_of_mann_and_whitney(ours, theirs):
    found = statistics.improvement([ours], [theirs])
    u = mannwhitneyu(ours, theirs).statistic
    assert found.value == pytest.approx(u / (len(ours) * len(theirs)))
    assert found.low <= found.value + 1e-9 and found.value - 1e-9 <= found.high


def test_runs_are_resampled_within_their_task_and_not_across():
    tasks = [np.full(4, 0.2), np.full(4, 0.8)]
    for estimate in (
        statistics.mean_interval(tasks),
        statistics.interquartile_interval(tasks),
        statistics.gap_interval(tasks, tasks),
    ):
        assert estimate.low == pytest.approx(estimate.high)
    assert statistics.mean_interval(tasks).value == pytest.approx(0.5)
    assert statistics.improvement(tasks, tasks[::-1]) == pytest.approx((0.5, 0.5, 0.5))


def test_tasks_weigh_the_same_whatever_their_number_of_seeds():
    found = statistics.mean_interval([np.zeros(9), np.ones(1)])
    assert found == pytest.approx((0.5, 0.5, 0.5))


def test_intervals_of_many_seeds_are_those_of_the_normal_distribution():
    generator = np.random.default_rng(1)
    x, y = generator.normal(1, 0.2, 400), generator.normal(0.5, 0.4, 300)
    low, high = x.mean() - 1.96 * x.std() / 20, x.mean() + 1.96 * x.std() / 20
    assert statistics.mean_interval([x]) == pytest.approx((x.mean(), low, high), abs=1e-3)
    error = np.sqrt(x.var() / 400 + y.var() / 300)
    gap = x.mean() - y.mean()
    expected = (gap, gap - 1.96 * error, gap + 1.96 * error)
    assert statistics.gap_interval([x], [y]) == pytest.approx(expected, abs=2e-3)


def test_the_interval_of_a_mean_has_the_quantiles_of_all_its_resamples():
    scores = np.array([0.0, 0.3, 0.5, 1.0])
    means = [np.mean(drawn) for drawn in itertools.product(scores, repeat=4)]
    found = statistics.mean_interval([scores])
    assert found[1:] == pytest.approx(np.percentile(means, (2.5, 97.5)), abs=0.03)
    assert (min(means) < found.low) and (found.high < max(means))


def test_the_interval_of_an_improvement_has_the_quantiles_of_all_its_resamples():
    ours, theirs = np.array([0.1, 0.4, 0.9]), np.array([0.2, 0.4, 0.6])
    drawn = [
        np.mean(np.greater.outer(x, y) + 0.5 * np.equal.outer(x, y))
        for x in itertools.product(ours, repeat=3)
        for y in itertools.product(theirs, repeat=3)
    ]
    found = statistics.improvement([ours], [theirs])
    assert found[1:] == pytest.approx(np.percentile(drawn, (2.5, 97.5)), abs=0.04)


def test_equal_runs_give_equal_intervals():
    scores = np.random.default_rng(2).uniform(size=7)
    assert statistics.mean_interval([scores]) == statistics.mean_interval([scores.copy()])
    once, again = (statistics.improvement([scores], [scores / 2]) for _ in range(2))
    assert once == again
