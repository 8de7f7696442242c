"""Success rate of the policies of a run, with its interval, seed by seed."""

import dataclasses
from pathlib import Path
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax import artefacts, evaluation, policy, task
from crsfd_jax.learn import networks
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.report.intervals import wilson_interval


class Options(NamedTuple):
    """What to evaluate; None stands for the run's own value."""

    run: str
    shape: str | None
    shift: float | None
    episodes: int
    seed: int
    engine: Literal["auto", "native", "mjx", "warp"]


def report(options: Options) -> None:
    """Prints a line for each seed and one for all of them."""
    config = artefacts.read_config(options.run)
    config = dataclasses.replace(
        config,
        shape=options.shape or config.shape,
        shift=config.shift if options.shift is None else options.shift,
        engine=options.engine,
    )
    env = task.make_env(config)
    nets = networks.make_networks(config.sac, ACTION_SIZE)

    def start(key):
        return nets.actor.init(key, jnp.zeros(OBS_SIZE))

    keys = jax.random.split(jax.random.key(options.seed), config.seeds)
    actors = policy.load(Path(options.run), jax.eval_shape(jax.vmap(start), keys))

    def play(actor, key):
        return evaluation.run(env, nets, actor, key, options.episodes)

    played = jax.jit(jax.vmap(play))(actors, keys)
    print(f"shape {config.shape}, shift {config.shift * 1e3:g} mm, deterministic policy")
    success, length = np.asarray(played.success), np.asarray(played.length)
    for i in range(config.seeds):
        print(f"seed {config.seed + i:<4d} {_line(success[i], length[i])}")
    print(f"all       {_line(success, length)}")


def _line(success: np.ndarray, length: np.ndarray) -> str:
    low, high = wilson_interval(int(success.sum()), success.size)
    return (
        f"success {success.mean():.3f}, 95 % interval {low:.3f} to {high:.3f} "
        f"({success.sum()} of {success.size}), {length.mean():.1f} steps on average"
    )
