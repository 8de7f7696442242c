"""How many successes does a warm-up that imitates demonstrations meet, with a moved hole?

Hypothesis: in its usual 2,000 steps, in which no arm completes an episode of 50 steps that it
begins, a run may meet none.

    python experiments/studies/warmup.py

For each shape and number of steps: the mean and the least number of successes over the seeds.
"""

import dataclasses
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax import algorithms, cli, compile_cache, preparation, task
from crsfd_jax.config import Config, Replay
from crsfd_jax.demos import builtin
from crsfd_jax.options.schedule import warmup_steps
from crsfd_jax.training import chunk, train_step


@dataclass(frozen=True)
class Warmup:
    """How many successes a warm-up that imitates demonstrations meets."""

    shapes: tuple[str, ...] = ("0", "2")
    """To insert."""
    shift: float = 8e-3
    """m, side of the square in which the hole may be."""
    steps: tuple[int, ...] = (2000, 3200)
    """Environment steps of warm-ups."""
    seeds: int = 20
    """Of each."""


def met(config: Config, seeds: int) -> np.ndarray:
    """[S] successes in the warm-up of a run."""
    given = preparation.make(config, builtin.load("builtin"))
    learner = train_step.make(task.make_env(config), algorithms.load(config.algorithm), config)
    states = jax.jit(jax.vmap(lambda seed: learner.init(jax.random.key(seed), given)))(
        jnp.arange(seeds)
    )
    _, metrics = chunk.make(learner, warmup_steps(config))(states, 0)
    return np.asarray(metrics["successes"])


def main(argv: list[str]) -> None:
    """Prints a line for each shape and number of steps."""
    options = cli.parse(Warmup, argv)
    compile_cache.enable()
    alone = Replay(capacity=max(options.steps) // 64 * 64 + 64, draw_demos="no")
    usual = Config(algorithm="sacfd", shift=options.shift, replay=alone)
    for shape in options.shapes:
        for steps in options.steps:
            sac = dataclasses.replace(usual.sac, warmup_steps=steps)
            found = met(dataclasses.replace(usual, shape=shape, sac=sac), options.seeds)
            print(
                f"shape {shape}, {steps} steps: {found.mean():.1f} successes, least {found.min()}"
            )


if __name__ == "__main__":
    cli.main(main)
