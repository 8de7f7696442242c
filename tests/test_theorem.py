"""The bound of Guo et al. 2022 on the shaped reward, on random tabular tasks.

For a state s before the goal of M_0 with sum |T_0 - T_k| = delta (under the same policy),
E r' >= (gamma_k - gamma_0) E_k V(s') - gamma_0 delta max V, positive below a threshold of delta.
"""

import jax.numpy as jnp
import numpy as np

from crsfd_jax.learn.replay import Backup
from crsfd_jax.learn.shaping import shape_reward

STATES = 8
GOAL = STATES - 1


def random_task(rng):
    """Transition rows [STATES, STATES] to a goal, gamma_0, and the value [STATES]."""
    moves = rng.dirichlet(np.full(STATES, 0.5), size=STATES)
    gamma = rng.uniform(0.8, 0.95)
    # The goal pays 1 and ends the episode, so V(goal) = 1.
    transient = gamma * moves
    transient[GOAL] = 0.0
    reward = np.eye(STATES)[GOAL]
    return moves, gamma, np.linalg.solve(np.eye(STATES) - transient, reward)


def moved(rng, row, delta):
    """A distribution at L1 distance `delta` (as far as it goes) from `row`."""
    target = rng.dirichlet(np.full(STATES, 0.3))
    distance = np.abs(target - row).sum()
    return row + min(1.0, delta / distance) * (target - row)


def expected_shaped_reward(value, state, row, gamma):
    """Expectation over next states of the library's own shaped 1-step reward."""
    backup = Backup(
        reward=jnp.zeros(STATES),
        next_obs=jnp.zeros((STATES, 1)),
        terminated=jnp.zeros(STATES, bool),
        length=jnp.ones(STATES, jnp.int32),
    )
    potential = jnp.full(STATES, value[state], jnp.float32)
    shaped = shape_reward(backup, potential, jnp.asarray(value, jnp.float32), gamma, "keep")
    return float(row @ np.asarray(shaped.reward))


def cases(number):
    rng = np.random.default_rng(0)
    for _ in range(number):
        moves, gamma_0, value = random_task(rng)
        gamma_k = rng.uniform(gamma_0, 0.999)
        state = rng.integers(GOAL)
        row = moved(rng, moves[state], rng.uniform(0.0, 1.0) ** 3)
        delta = np.abs(row - moves[state]).sum()
        gain = (gamma_k - gamma_0) * (row @ value)
        shaped = expected_shaped_reward(value, state, row, gamma_k)
        yield gamma_0, delta, gain, value.max(), shaped


def test_the_bound_holds_always_and_is_positive_below_the_threshold():
    below = 0
    for gamma_0, delta, gain, largest, shaped in cases(1000):
        assert shaped >= gain - gamma_0 * delta * largest - 1e-5
        if delta < gain / (gamma_0 * largest):
            below += 1
            assert shaped > 0
    assert below > 50


def test_above_the_threshold_the_shaped_reward_can_be_negative():
    above = [
        shaped
        for gamma_0, delta, gain, largest, shaped in cases(1000)
        if delta > gain / (gamma_0 * largest)
    ]
    assert sum(shaped < -1e-3 for shaped in above) > 50


def test_without_a_mismatch_or_a_larger_gamma_the_shaped_reward_is_zero():
    rng = np.random.default_rng(1)
    moves, gamma_0, value = random_task(rng)
    for state in range(GOAL):
        shaped = expected_shaped_reward(value, state, moves[state], gamma_0)
        np.testing.assert_allclose(shaped, 0.0, atol=1e-6)
