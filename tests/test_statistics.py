"""Numbers that compare runs, against scipy, closed forms and numbers worked out by hand."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import stdtrit
from scipy.stats import mannwhitneyu, trim_mean, ttest_1samp

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


def test_a_level_counts_once_it_was_reached_three_times_in_a_row():
    steps = np.arange(10, 80, 10)
    values = np.array([0.2, 0.95, 0.8, 0.9, 1.0, 0.9, 0.5])
    assert statistics.settled_at(steps, values, 0.9) == 40
    assert statistics.settled_at(steps, values, 0.91) == np.inf
    assert statistics.settled_at(steps[:5], values[:5], 0.9) == np.inf
    assert statistics.settled_at(steps, np.where(values == 0.8, NAN, values), 0.9) == 20
    assert statistics.settled_at(steps[:1], np.array([0.9]), 0.9) == 10
    assert statistics.settled_at(steps[:0], values[:0], 0.9) == np.inf


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


def named(*tasks):
    """Scores of tasks, and of each the seeds 0, 1, ..."""
    return list(tasks), [np.arange(len(scores)) for scores in tasks]


def test_runs_are_compared_within_their_task_and_not_across():
    tasks = [np.full(4, 0.2), np.full(4, 0.8)]
    estimates = statistics.mean_interval(*named(*tasks)), statistics.interquartile_interval(tasks)
    for estimate in estimates:
        assert estimate.low == pytest.approx(estimate.high)
    assert estimates[0].value == pytest.approx(0.5)
    assert statistics.improvement(tasks, tasks[::-1]) == pytest.approx((0.5, 0.5, 0.5))


def test_tasks_weigh_the_same_whatever_their_number_of_seeds():
    found = statistics.mean_interval(*named(np.zeros(9), np.ones(2)))
    assert found == pytest.approx((0.5, 0.5, 0.5))


def test_one_seed_says_nothing_of_the_interval():
    found = statistics.mean_interval(*named(np.zeros(9), np.ones(1)))
    assert found == (0.5, -np.inf, np.inf)


@settings(max_examples=30, deadline=None)
@given(rates.filter(lambda scores: len(scores) > 1 and np.ptp(scores) > 0))
def test_the_interval_of_a_mean_is_that_of_students_t_in_scipy(scores):
    found = statistics.mean_interval(*named(scores))
    expected = ttest_1samp(scores, 0).confidence_interval(0.95)
    assert found == pytest.approx((scores.mean(), expected.low, expected.high))


def test_of_the_same_seeds_on_several_tasks_each_seed_counts_once():
    scores = np.random.default_rng(3).uniform(size=(3, 5))
    found = statistics.mean_interval(*named(*scores))
    assert found == pytest.approx(statistics.mean_interval(*named(scores.mean(axis=0))))
    repeated = statistics.mean_interval(*named(*[scores[0]] * 3))
    assert repeated == pytest.approx(statistics.mean_interval(*named(scores[0])))
    gap = statistics.weighted_interval(*named(*scores), [0.5, 0.5, -1])
    single = scores[:2].mean(axis=0) - scores[2]
    assert gap == pytest.approx(statistics.mean_interval(*named(single)))


def test_other_seeds_on_another_task_count_as_independent():
    x, y = np.random.default_rng(4).normal(size=(2, 6))
    found = statistics.mean_interval([x, y], [np.arange(6), np.arange(6, 12)])
    error = np.sqrt((x.var(ddof=1) + y.var(ddof=1)) / 6) / 2
    assert found.high - found.value == pytest.approx(stdtrit(5, 0.975) * error)


def test_the_interval_covers_the_mean_of_few_seeds_as_often_as_it_says():
    draws = np.random.default_rng(5).normal(size=(2000, 5))
    found = [statistics.mean_interval(*named(draw)) for draw in draws]
    covered = np.mean([estimate.low < 0 < estimate.high for estimate in found])
    assert covered == pytest.approx(0.95, abs=0.015)


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
    once, again = (statistics.improvement([scores], [scores / 2]) for _ in range(2))
    assert once == again


def test_the_same_seeds_are_drawn_on_all_tasks():
    ours, theirs = np.random.default_rng(6).uniform(size=(2, 5))
    once = statistics.improvement([ours], [theirs])
    assert statistics.improvement([ours] * 4, [theirs] * 4) == pytest.approx(once)
    once = statistics.interquartile_interval([ours])
    twice = statistics.interquartile_interval([ours, ours])
    assert twice.high - twice.low > 0.8 * (once.high - once.low)
