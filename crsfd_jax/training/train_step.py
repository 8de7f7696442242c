"""One fused training step: act, simulate, store, sample, reward, update, reprioritise.

Everything here is for one seed; the trainer vmaps over seeds and scans over steps. The step
counter is the same for all seeds and stays outside the state, so that its branches stay branches.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import flax.struct
import jax
import jax.numpy as jnp

from crsfd_jax.algorithms.method import Method, Preparation
from crsfd_jax.config import Config
from crsfd_jax.env import Env, EnvState, Outcome
from crsfd_jax.learn import networks, replay, sac
from crsfd_jax.learn.replay import Batch
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.options.schedule import warmup_steps
from crsfd_jax.training import warmup
from crsfd_jax.types import Transition


@flax.struct.dataclass(kw_only=True)
class TrainState:
    """All that one seed carries from step to step."""

    agent: sac.AgentState
    prepared: Any
    """What the method learned from the demonstrations."""
    replay: replay.ReplayState
    env: EnvState
    key: jax.Array


class Learner(NamedTuple):
    """Functions of one run, with its options bound."""

    init: Callable[[jax.Array, Preparation], TrainState]
    """(key, preparation) -> state of one seed before its first step."""
    step: Callable[[TrainState, jax.Array], tuple[TrainState, dict[str, jax.Array]]]
    """(state, step) -> state after one vector step, metrics."""
    nets: networks.Networks


def make(env: Env, method: Method, config: Config) -> Learner:
    """The learner of a method on an environment."""
    config = method.configure(config)
    nets = networks.make_networks(config.sac, ACTION_SIZE)
    first_update = warmup_steps(config)
    update = functools.partial(learn, nets, method, config)

    def init(key: jax.Array, preparation: Preparation) -> TrainState:
        agent_key, method_key, env_key, age_key, key = jax.random.split(key, 5)
        demos = preparation.demos
        if not method.uses_demos:
            demos = jax.tree.map(lambda x: x[:0], demos)
        asked = {"yes": True, "no": False}.get(config.replay.draw_demos)
        draws = method.draws_demos(preparation, config) if asked is None else asked
        start = env.reset(env_key, config.envs)
        # Environments begin at different ages, so that their resets do not come in waves.
        age = jax.random.randint(age_key, (config.envs,), 0, env.horizon)
        return TrainState(
            agent=sac.init(nets, OBS_SIZE, agent_key, config),
            prepared=method.prepare(method_key, preparation, config),
            replay=replay.init(demos, config.envs, config.replay, draws),
            env=start.replace(age=age),
            key=key,
        )

    def step(state: TrainState, step: jax.Array) -> tuple[TrainState, dict[str, jax.Array]]:
        act_key, env_key, learn_key, key = jax.random.split(state.key, 4)
        state, tally = state.replace(key=key), {}
        if method.interacts:
            action = _act(nets, state, step < first_update, act_key, config.sac.warmup)
            next_env, outcome = env.step(state.env, action, env_key)
            transition = transition_of(state.env, action, outcome)
            buffer = replay.add(state.replay, transition, outcome.finite, step)
            state, tally = state.replace(env=next_env, replay=buffer), _tally(outcome)

        idle = jax.tree.map(jnp.zeros_like, jax.eval_shape(update, state, step, learn_key)[1])
        state, losses = jax.lax.cond(
            step < first_update,
            lambda state: (state, idle),
            lambda state: update(state, step, learn_key),
            state,
        )
        return state, {**losses, **tally}

    return Learner(init=init, step=step, nets=nets)


def _act(nets, state, warming_up, key, how):
    """Actions [E, A]: those of the warm-up, then sampled from the policy."""
    policy_key, warmup_key = jax.random.split(key)
    obs = state.env.obs
    return jax.lax.cond(
        warming_up,
        lambda: warmup.action(state.replay, obs, warmup_key, how),
        lambda: networks.sample_action(nets.actor, state.agent.actor, obs, policy_key)[0],
    )


def transition_of(before: EnvState, action: jax.Array, outcome: Outcome) -> Transition:
    """What a step is stored as: the observation before it, and its outcome before any reset."""
    return Transition(
        obs=before.obs,
        action=action,
        reward=outcome.reward,
        next_obs=outcome.next_obs,
        terminated=outcome.terminated,
        truncated=outcome.truncated,
    )


def learn(
    nets: networks.Networks,
    method: Method,
    config: Config,
    state: TrainState,
    step: jax.Array,
    key: jax.Array,
) -> tuple[TrainState, dict[str, jax.Array]]:
    """All gradient updates of vector step `step`, and the new priorities; with metrics.

    Args:
      config: as the method configures it.
    """
    draw_key, update_key, adapt_key = jax.random.split(key, 3)
    shape = (config.sac.updates_per_step, config.sac.batch_size)
    draw = method.draw(state.replay, step, draw_key, shape, config.replay)
    prepared = method.adapt(state.prepared, state.replay, draw, adapt_key, config)
    rewards = method.relabel(prepared, state.replay, draw, config)
    batches = replay.gather(state.replay, draw, rewards, config.sac.gamma)
    batches = _scaled(method.reward(prepared, batches, config), config.sac.reward_scale)
    nets = method.networks(prepared, nets, config)

    def update(agent, each):
        batch, key = each
        agent, td_error, metrics = method.update(nets, agent, batch, key, config)
        return agent, (td_error, metrics)

    keys = jax.random.split(update_key, config.sac.updates_per_step)
    agent, (td_error, metrics) = jax.lax.scan(update, state.agent, (batches, keys))
    # In units of the rewards, as the floor and the bonus are: their scale changes no priority.
    td_error = td_error / config.sac.reward_scale
    buffer = replay.reprioritise(state.replay, draw, td_error, config.replay)
    is_demo = draw.rows[..., 0] < state.replay.num_demos
    metrics = {**metrics, "demo_share": jnp.mean(is_demo, dtype=jnp.float32)}
    state = state.replace(agent=agent, prepared=prepared, replay=buffer)
    # Averaged together with the zeros of the steps of warm-up, it is the share of the others.
    return state, {**jax.tree.map(jnp.mean, metrics), "learned": jnp.float32(1.0)}


def _scaled(batch: Batch, scale: float) -> Batch:
    one, several = (b.replace(reward=scale * b.reward) for b in (batch.one_step, batch.n_step))
    return batch.replace(one_step=one, n_step=several)


def _tally(outcome: Outcome) -> dict[str, jax.Array]:
    happened = {
        "episodes": outcome.terminated | outcome.truncated,
        "successes": outcome.terminated,
        "nonfinite": ~outcome.finite,
        "contact_limit": outcome.limits.contacts,
        "solver_limit": outcome.limits.solver,
    }
    return {name: jnp.sum(each) for name, each in happened.items() if each is not None}
