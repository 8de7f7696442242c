"""Monte-Carlo returns of recorded episodes; nothing here is learned."""

import numpy as np

from crsfd_jax.types import Transition


def monte_carlo_returns(demos: Transition, gamma: float) -> np.ndarray:
    """Discounted sum [D] of the rewards from each row to the end of its episode.

    An episode ends at a terminated or truncated row; a truncated one only sums what is there.

    Source: Guo et al. 2022, Algorithm 1: V(s_t) = sum_i gamma_0^(i-t) r_i.
    """
    rewards = np.asarray(demos.reward, np.float64)
    ended = np.asarray(demos.terminated) | np.asarray(demos.truncated)
    returns = np.zeros_like(rewards)
    following = 0.0
    for row in reversed(range(len(rewards))):
        following = rewards[row] + (0.0 if ended[row] else gamma * following)
        returns[row] = following
    return returns.astype(np.float32)
