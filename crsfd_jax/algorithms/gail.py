"""GAIL off-policy: SAC that is paid for looking like the demonstrations.

The demonstrations train the discriminator D(s, a), and are imitated in the warm-up; no batch holds
them. The reward is -log(1 - D), of the newest discriminator for every row drawn, times 1 - gamma,
so that returns are weighted means of it, and times SCALE.

That reward is positive, so ending an episode by success would end the pay. As in DAC, success
leads to an absorbing state that pays for ever. Here it is not stored: being one point that
demonstrations and experience share, its best logit is the log ratio of how often they reach it,
and its value is added to the step that ends there. A policy that ends as often as the
demonstrations is paid there as everywhere else; one that ends less often is paid more for it. All
ends of this task are successes: that pay tells the policy of them as the task's reward would.

Source: Ho and Ermon 2016 (arXiv 1606.03476); Kostrikov et al. 2019 (arXiv 1809.02925, DAC).
"""

from collections.abc import Callable

import flax.struct
import jax
import jax.numpy as jnp

from crsfd_jax.algorithms import sac
from crsfd_jax.algorithms.method import Method, Preparation
from crsfd_jax.config import Config
from crsfd_jax.learn import discriminator
from crsfd_jax.learn.replay import Draw, ReplayState
from crsfd_jax.types import Transition

SCALE = 5.0
"""Puts imitation before entropy; a quarter of it learns shape 3 as soon, a sixteenth later."""
Features = Callable[[Transition], jax.Array]
"""Rows [...] -> what the discriminator sees of them [..., F]."""


@flax.struct.dataclass(kw_only=True)
class Judge:
    """What decides how much a step looks like a demonstration."""

    discriminator: discriminator.Discriminator
    success_share: jax.Array
    """[] share of the demonstrated steps that succeed."""


def observation_and_action(rows: Transition) -> jax.Array:
    """Features of D(s, a)."""
    return jnp.concatenate([rows.obs, rows.action], axis=-1)


def method(features: Features) -> Method:
    """GAIL with a discriminator of these features."""

    def prepare(key: jax.Array, preparation: Preparation, config: Config) -> Judge:
        demos = preparation.demos
        return Judge(
            discriminator=discriminator.init(key, features(demos), config.sac.hidden),
            success_share=jnp.mean(demos.terminated, dtype=jnp.float32),
        )

    def adapt(
        judge: Judge, buffer: ReplayState, draw: Draw, key: jax.Array, config: Config
    ) -> Judge:
        agent = features(_read(buffer, draw.rows[..., 0]))
        keys = jax.random.split(key, len(agent))
        learned, _ = jax.lax.scan(
            lambda learned, each: (discriminator.update(learned, *each), None),
            judge.discriminator,
            (agent, keys),
        )
        return judge.replace(discriminator=learned)

    def relabel(judge: Judge, buffer: ReplayState, draw: Draw, config: Config) -> jax.Array:
        rows = _read(buffer, draw.rows)
        logits = discriminator.logits(judge.discriminator, features(rows))
        ending = absorbing_logit(judge.success_share, buffer)
        return SCALE * imitation_reward(logits, rows.terminated, ending, config.sac.gamma)

    return Method(
        draws_demos=_never,
        configure=sac.configure,
        prepare=prepare,
        adapt=adapt,
        relabel=relabel,
    )


def _never(preparation: Preparation, config: Config) -> bool:
    return False


def imitation_reward(
    logits: jax.Array, terminated: jax.Array, ending: jax.Array, gamma: float
) -> jax.Array:
    """(1 - gamma) p(logit), and gamma p(ending) more at success; p(l) = -log(1 - D).

    That is the reward of a step, and of all steps to come in the absorbing state:
    sum_{k >= 1} gamma^k (1 - gamma) p(ending).
    """
    paid = (1 - gamma) * jax.nn.softplus(logits)
    return paid + jnp.where(terminated, gamma * jax.nn.softplus(ending), 0.0)


def absorbing_logit(success_share: jax.Array, buffer: ReplayState) -> jax.Array:
    """Log ratio [] of the shares of successes in the demonstrations and in the experience.

    One success more is counted than there was, so that it is finite before the first.
    """
    stored = jnp.sum(buffer.priority[buffer.num_demos :] > 0)
    succeeded = jnp.sum(buffer.storage.terminated[buffer.num_demos :])
    return jnp.log(success_share) - jnp.log((succeeded + 1) / (stored + 1))


def _read(buffer: ReplayState, rows: jax.Array) -> Transition:
    return jax.tree.map(lambda leaf: leaf[rows], buffer.storage)


METHOD = method(observation_and_action)
