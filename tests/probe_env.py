"""An environment of a few lines with a known solution, in the place of the simulator."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax.algorithms.method import Preparation
from crsfd_jax.config import Config, Evaluation, Replay, Sac
from crsfd_jax.demos.record import no_demonstrations
from crsfd_jax.env import Env, EnvState, Outcome
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.physics.interface import Limits, PhysicsState, Surroundings
from crsfd_jax.training import chunk
from crsfd_jax.types import Transition

HORIZON = 8


def config(**changes) -> Config:
    """Networks and buffers small enough for a test of seconds; rewards as they are."""
    values = {
        "algorithm": "sacfd",
        "seeds": 3,
        "envs": 4,
        "steps": 1024,
        "sac": Sac(
            hidden=(16, 16), batch_size=8, updates_per_step=2, warmup_steps=16, reward_scale=1.0
        ),
        "replay": Replay(capacity=64),
        "evaluation": Evaluation(every=256, episodes=5),
    }
    return Config(**(values | changes))


def eager_config(algorithm: str, **changes) -> Config:
    """Options with which `assert_learned` holds."""
    sac = dataclasses.replace(config().sac, learning_rate=3e-3, updates_per_step=4)
    return config(algorithm=algorithm, sac=sac, **changes)


def assert_learned(learner, states):
    """Advances seeds by 170 steps, in the last 34 of which nearly every first action succeeds.

    Returns:
      States and metrics after them.
    """
    advance = chunk.make(learner, 34)
    for step in range(0, 170, 34):
        states, metrics = advance(states, jnp.int32(step))
    share = np.asarray(metrics["successes"] / metrics["episodes"])
    length = 34 * 4 / np.asarray(metrics["episodes"])
    assert (share > 0.95).all() and (length < 1.6).all(), (share, length)
    return states, metrics


def make(breaks_at: float = jnp.inf) -> Env:
    """The first action, if positive, is rewarded and ends the episode.

    Insertions count as met limits of the solver, time limits as those of contacts.
    The first entry of an observation counts steps; an environment whose second entry, drawn
    at reset from [0, 1], is above `breaks_at` returns a non-finite state.
    """

    def reset(key, count):
        draw = jax.random.uniform(key, (count,))
        obs = jnp.zeros((count, OBS_SIZE)).at[:, 1].set(draw)
        zeros = jnp.zeros((count, 7))
        return EnvState(
            physics=PhysicsState(qpos=zeros, qvel=zeros, warmstart=zeros),
            around=Surroundings(
                shape=jnp.zeros(count, jnp.int32),
                socket_offset=jnp.zeros((count, 2)),
                friction=jnp.ones(count),
            ),
            tip=jnp.zeros((count, 6)),
            obs=obs,
            age=jnp.zeros(count, jnp.int32),
        )

    def advance(state, action):
        age = state.age + 1
        finite = state.obs[:, 1] <= breaks_at
        next_obs = state.obs.at[:, 0].add(1.0)
        next_obs = jnp.where(finite[:, None], next_obs, jnp.nan)
        terminated = finite & (action[:, 0] > 0)
        truncated = finite & ~terminated & (age >= HORIZON)
        outcome = Outcome(
            next_obs=next_obs,
            reward=terminated.astype(jnp.float32),
            terminated=terminated,
            truncated=truncated,
            finite=finite,
            tip=state.tip,
            limits=Limits(contacts=truncated, solver=terminated),
        )
        return state.replace(obs=next_obs, age=age), outcome

    def step(state, action, key):
        going, outcome = advance(state, action)

        def pick(new, old):
            over = outcome.over
            return jnp.where(over.reshape(over.shape + (1,) * (new.ndim - 1)), new, old)

        return jax.tree.map(pick, reset(key, len(outcome.over)), going), outcome

    return Env(reset=reset, step=step, advance=advance, horizon=HORIZON)


def preparation(num_demos: int = 6) -> Preparation:
    """Demonstrations of two steps each, the second one rewarded."""
    if num_demos == 0:
        return Preparation(demos=no_demonstrations(), free_space=free_space)
    ends = jnp.arange(num_demos) % 2 == 1
    obs = jnp.zeros((num_demos, OBS_SIZE)).at[:, 0].set(ends)
    demos = Transition(
        obs=obs,
        action=jnp.full((num_demos, ACTION_SIZE), 0.5),
        reward=ends.astype(jnp.float32),
        next_obs=obs.at[:, 0].add(1.0),
        terminated=ends,
        truncated=jnp.zeros(num_demos, bool),
    )
    return Preparation(demos=demos, free_space=free_space)


def free_space(key, count):
    """Tip poses anywhere."""
    return jax.random.uniform(key, (count, 6), minval=-3.0, maxval=3.0)
