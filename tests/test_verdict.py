"""The last line of a run, and its exit code."""

import pytest

from crsfd_jax.config import Config, Evaluation
from crsfd_jax.intervals import rate_interval
from crsfd_jax.training.verdict import judge


def config(**changes) -> Config:
    return Config(seeds=4, seed=10, evaluation=Evaluation(episodes=50), **changes)


def test_all_episodes_of_all_seeds_are_one_rate_with_its_interval():
    line, code = judge(config(), [1.0, 0.9, 0.94, 0.5], {}, 61.2)
    low, high = rate_interval([50, 45, 47, 25], [50] * 4)
    assert line == (
        f"final success 0.835, 95 % interval {low:.3f} to {high:.3f} "
        "(167 of 200 episodes, 4 seeds), 61 s"
    )
    assert code == 0


def test_a_seed_that_diverged_does_not_count_and_is_named_with_its_step():
    line, code = judge(config(), [1.0, 0.0, 0.9, 0.8], {"11": 12_000}, 1.0)
    assert "(135 of 150 episodes, 3 of 4 seeds, seed 11 diverged at 12,000 steps)" in line
    assert code == 0


def test_no_seed_that_counts_is_a_target_missed():
    diverged = {"10": 5, "11": 6, "12": 7, "13": 8}
    line, code = judge(config(), [0.0] * 4, diverged, 1.0)
    assert line.startswith("final success unknown: no seed counts (seed 10 diverged at 5 steps, ")
    assert code == 1


@pytest.mark.parametrize(("target", "word", "code"), [(0.9, "reached", 0), (0.91, "missed", 1)])
def test_a_target_is_reached_or_missed(target, word, code):
    line, found = judge(config(target=target), [0.9, 0.9, 0.8, 1.0], {}, 1.0)
    assert line.endswith(f", target {target:g} {word}")
    assert found == code


def test_a_seed_that_diverged_has_failed_where_there_is_a_target():
    lost = {"11": 5, "12": 6, "13": 7}
    line, code = judge(config(target=0.9), [1.0, 0.0, 0.0, 0.0], lost, 1.0)
    assert "final success 1.000" in line and line.endswith("target 0.9 missed") and code == 1


def test_a_target_that_is_reached_exactly_is_reached():
    options = Config(seeds=2, target=0.55, evaluation=Evaluation(episodes=50))
    assert judge(options, [0.56, 0.54], {}, 1.0).code == 0
