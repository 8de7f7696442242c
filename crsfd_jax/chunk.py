"""The unit that is compiled: many training steps of all seeds in one program."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.sharding import Mesh

from crsfd_jax import spread
from crsfd_jax.train_step import Learner, TrainState

Metrics = dict[str, jax.Array]
Chunk = Callable[[TrainState, jax.typing.ArrayLike], tuple[TrainState, Metrics]]
"""(states [S], step) -> states after the chunk, metrics [S]; the states given are consumed."""


def make(learner: Learner, length: int, mesh: Mesh | None = None) -> Chunk:
    """A chunk of `length` vector steps; counts are added up, other metrics averaged.

    Args:
      mesh: the devices that share the seeds; None for one.
    """

    def run(states: TrainState, step: jax.Array) -> tuple[TrainState, Metrics]:
        def body(states, step):
            return jax.vmap(learner.step, in_axes=(0, None))(states, step)

        states, metrics = jax.lax.scan(body, states, step + jnp.arange(length))
        return states, {name: _summarise(values) for name, values in metrics.items()}

    return jax.jit(spread.split(run, mesh, spread.WHOLE), donate_argnums=0)


def _summarise(values: jax.Array) -> jax.Array:
    """[T, S] -> [S]."""
    is_count = jnp.issubdtype(values.dtype, jnp.integer)
    return values.sum(axis=0) if is_count else values.mean(axis=0)
