"""What a learning method may change about the common learner; each method says only that."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax

from crsfd_jax.config import Config
from crsfd_jax.learn.replay import Batch
from crsfd_jax.types import Transition

FreeSpace = Callable[[jax.Array, int], jax.Array]
"""(key, count) -> [count, O] observations of states anywhere in free space."""


class Preparation(NamedTuple):
    """What a method may learn from before training starts."""

    demos: Transition
    """[D] demonstrations."""
    free_space: FreeSpace


def _nothing(key: jax.Array, preparation: Preparation, config: Config) -> Any:
    return ()


def _as_drawn(prepared: Any, batch: Batch, config: Config) -> Batch:
    return batch


def _as_given(config: Config) -> Config:
    return config


class Method(NamedTuple):
    """A method as differences from SAC with demonstrations (SACfD)."""

    uses_demos: bool = True
    """Whether demonstrations are pinned in the replay buffer."""
    configure: Callable[[Config], Config] = _as_given
    """Options that the method fixes."""
    prepare: Callable[[jax.Array, Preparation, Config], Any] = _nothing
    """(key, preparation, config) -> what the method keeps during training, per seed."""
    reward: Callable[[Any, Batch, Config], Batch] = _as_drawn
    """(prepared, batch [U, B], config) -> the batch with the method's rewards."""
