"""The unit that is compiled: many training steps of all seeds in one program."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import Mesh

from crsfd_jax.training import devices
from crsfd_jax.training.train_step import Learner, TrainState

Metrics = dict[str, jax.Array]
Step = Callable[[TrainState, Any, jax.Array], tuple[TrainState, Metrics]]
"""(state, own, step) -> state of one seed after a vector step, metrics."""
Chunk = Callable[[TrainState, Any, jax.typing.ArrayLike], tuple[TrainState, Metrics]]
"""(states [S], own [S], step) -> states after the chunk, metrics [S].

The states given are consumed. `own` tells a seed's learner from those of other seeds; it is no
part of the program, which is the same for other seeds and tasks.
"""


def make(
    learner: Learner, length: int
) -> Callable[[TrainState, jax.typing.ArrayLike], tuple[TrainState, Metrics]]:
    """A chunk of `length` vector steps of one learner's seeds: (states [S], step) -> as above."""
    advance = of_each(lambda state, own, step: learner.step(state, step), length)
    return lambda states, step: advance(states, (), step)


def of_each(advance: Step, length: int, mesh: Mesh | None = None) -> Chunk:
    """A chunk of `length` vector steps; counts are added up, other metrics averaged.

    Args:
      mesh: the devices that share the seeds; None for one.
    """

    def run(states: TrainState, own: Any, step: jax.Array) -> tuple[TrainState, Metrics]:
        def body(states, step):
            return jax.vmap(advance, in_axes=(0, 0, None))(states, own, step)

        states, metrics = jax.lax.scan(body, states, step + jnp.arange(length))
        return states, {name: _summarise(values) for name, values in metrics.items()}

    return jax.jit(devices.split(run, mesh, devices.SEEDS, devices.WHOLE), donate_argnums=0)


def _summarise(values: jax.Array) -> jax.Array:
    """[T, S] -> [S]."""
    is_count = jnp.issubdtype(values.dtype, jnp.integer)
    return values.sum(axis=0) if is_count else values.mean(axis=0)
