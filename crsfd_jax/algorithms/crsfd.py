"""CRSfD: SACfD whose rewards are shaped by a conservative value function of the demonstrations.

Source: Guo et al. 2022, Algorithm 1. The potential sees the tip's pose and nothing else: joint
angles follow from it, and velocities would let a network tell demonstrations from samples.

Where the socket of the new task may have moved by an unknown offset, the demonstrations are
moved as it may have: the potential is their value averaged over the places of the socket. One
that is fitted to the demonstrated place alone has its top there, beside the hole. Demonstrations
whose sockets had moved themselves are moved by what is left of the square.

Where the square of the new task is wider than theirs, demonstrations only fit the potential, which
says how deep, and leaves open where. In the warm-up they are imitated (training/warmup.py).
"""

import functools

import jax
import jax.numpy as jnp

from crsfd_jax.algorithms.method import Method, Preparation, in_place, mismatch
from crsfd_jax.config import Config
from crsfd_jax.learn import potential
from crsfd_jax.learn.replay import Batch
from crsfd_jax.learn.shaping import shape_reward
from crsfd_jax.observation import POSE_SCALE, TIP_POSE


def prepare(key: jax.Array, preparation: Preparation, config: Config) -> potential.FittedPotential:
    """Fits the potential to the demonstrations and to free space."""
    obs, targets = potential.demonstration_targets(preparation.demos, config.potential)
    spread = config.potential.spread
    if spread is None:
        spread = mismatch(preparation, config)
    move = functools.partial(moved, spread=spread)
    poses, free_space = obs[..., TIP_POSE], preparation.free_space
    return potential.fit(key, poses, targets, free_space, config.potential, move)


def moved(key: jax.Array, poses: jax.Array, spread: float) -> jax.Array:
    """Tip poses [n, 6], in units of POSE_SCALE, each moved in a square of this side, m, in x, y.

    A side that is not positive moves nothing.
    """
    half = jnp.maximum(spread / 2 / POSE_SCALE[:2], 0.0)
    return poses.at[:, :2].add(jax.random.uniform(key, (len(poses), 2), minval=-half, maxval=half))


def reward(fitted: potential.FittedPotential, batch: Batch, config: Config) -> Batch:
    """Shapes the rewards of experience and demonstrations alike, with the new task's discount."""
    gamma, terminal = config.sac.gamma, config.potential.terminal
    before = potential.evaluate(fitted, batch.obs[..., TIP_POSE])

    def shaped(backup):
        after = potential.evaluate(fitted, backup.next_obs[..., TIP_POSE])
        return shape_reward(backup, before, after, gamma, terminal)

    return batch.replace(one_step=shaped(batch.one_step), n_step=shaped(batch.n_step))


METHOD = Method(options=("potential",), draws_demos=in_place, prepare=prepare, reward=reward)
