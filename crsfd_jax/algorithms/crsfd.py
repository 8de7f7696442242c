"""CRSfD: SACfD whose rewards are shaped by a conservative value function of the demonstrations.

Source: Guo et al. 2022, Algorithm 1. The potential sees the tip's pose and nothing else: joint
angles follow from it, and velocities would let a network tell demonstrations from samples.
"""

import jax

from crsfd_jax.algorithms.method import Method, Preparation
from crsfd_jax.config import Config
from crsfd_jax.learn import potential
from crsfd_jax.learn.replay import Batch
from crsfd_jax.learn.shaping import shape_reward
from crsfd_jax.observation import TIP_POSE


def prepare(key: jax.Array, preparation: Preparation, config: Config) -> potential.Potential:
    """Fits the potential to the demonstrations and to free space."""
    obs, targets = potential.demonstration_targets(preparation.demos, config.potential)

    def sample_features(key: jax.Array, count: int) -> jax.Array:
        return preparation.free_space(key, count)[..., TIP_POSE]

    fitted, _ = potential.fit(key, obs[..., TIP_POSE], targets, sample_features, config.potential)
    return fitted


def reward(fitted: potential.Potential, batch: Batch, config: Config) -> Batch:
    """Shapes the rewards of experience and demonstrations alike, with the new task's discount."""
    gamma, terminal = config.sac.gamma, config.potential.terminal
    before = potential.evaluate(fitted, batch.obs[..., TIP_POSE])

    def shaped(backup):
        after = potential.evaluate(fitted, backup.next_obs[..., TIP_POSE])
        return shape_reward(backup, before, after, gamma, terminal)

    return batch.replace(one_step=shaped(batch.one_step), n_step=shaped(batch.n_step))


METHOD = Method(prepare=prepare, reward=reward)
