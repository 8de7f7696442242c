"""What a learning method may change about the common learner; each method says only that."""

from collections.abc import Callable
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp

from crsfd_jax.config import Config
from crsfd_jax.demos.dataset import Demonstrations
from crsfd_jax.learn import replay, sac
from crsfd_jax.learn.networks import Networks
from crsfd_jax.learn.potential import FreeSpace
from crsfd_jax.learn.replay import Batch, Draw, ReplayState
from crsfd_jax.types import Transition


class Preparation(NamedTuple):
    """What a method may learn from before training starts."""

    demos: Transition
    """[D] demonstrations."""
    free_space: FreeSpace
    """Tip poses anywhere in free space, as observations hold them."""
    demo_shift: float = 0.0
    """m, side of the square in which the sockets of the demonstrations stood."""

    @classmethod
    def of(cls, demos: Demonstrations, free_space: FreeSpace) -> Self:
        """With demonstrations as they are read from a file."""
        names = Transition.__dataclass_fields__
        transitions = Transition(**{name: jnp.asarray(getattr(demos, name)) for name in names})
        return cls(transitions, free_space, demos.provenance.shift_m)


def mismatch(preparation: Preparation, config: Config) -> Any:
    """m, side of the square in which the socket stands, less that of the demonstrations."""
    return config.shift - preparation.demo_shift


def in_place(preparation: Preparation, config: Config) -> Any:
    """Whether the socket stands where it stood in the demonstrations.

    If it may stand beside, they insert without a search, and who learns from them as rows of the
    batches searches less (docs/when_shaping_helps.md).
    """
    return mismatch(preparation, config) <= 0


def _as_given(config: Config) -> Config:
    return config


def _always(preparation: Preparation, config: Config) -> Any:
    return True


def _nothing(key: jax.Array, preparation: Preparation, config: Config) -> Any:
    return ()


def _frozen(prepared: Any, buffer: ReplayState, draw: Draw, key: jax.Array, config: Config) -> Any:
    return prepared


def _as_stored(prepared: Any, buffer: ReplayState, draw: Draw, config: Config) -> jax.Array:
    return buffer.storage.reward[draw.rows]


def _as_drawn(prepared: Any, batch: Batch, config: Config) -> Batch:
    return batch


def _common(prepared: Any, nets: Networks, config: Config) -> Networks:
    return nets


class Method(NamedTuple):
    """A method as differences from SAC with demonstrations (SACfD).

    The hooks stand in the order in which a training step calls them.
    """

    uses_demos: bool = True
    """Whether demonstrations are pinned in the replay buffer."""
    interacts: bool = True
    """Whether the policy acts in the environment while it learns."""
    options: tuple[str, ...] = ()
    """Options of the group potential that the method reads, or the whole group; asked for with a
    method that does not, they are refused."""
    idle: tuple[str, ...] = ()
    """Options of the common learner that the method does not read; they are refused likewise."""
    configure: Callable[[Config], Config] = _as_given
    """Options that the method fixes."""
    draws_demos: Callable[[Preparation, Config], Any] = _always
    """(preparation, config) -> [] bool, whether pinned demonstrations are drawn by priority, if
    config.replay.draw_demos leaves it to the method."""
    prepare: Callable[[jax.Array, Preparation, Config], Any] = _nothing
    """(key, preparation, config) -> what the method keeps during training, per seed."""
    draw: Callable[..., Draw] = replay.draw
    """(buffer, step, key, (U, B), config.replay) -> which rows to learn from."""
    adapt: Callable[[Any, ReplayState, Draw, jax.Array, Config], Any] = _frozen
    """(prepared, buffer, draw, key, config) -> prepared after learning on from the rows drawn."""
    relabel: Callable[[Any, ReplayState, Draw, Config], jax.Array] = _as_stored
    """(prepared, buffer, draw, config) -> rewards [U, B, n] of the rows drawn."""
    reward: Callable[[Any, Batch, Config], Batch] = _as_drawn
    """(prepared, batch [U, B], config) -> the batch with the method's shaping, not scaled yet."""
    networks: Callable[[Any, Networks, Config], Networks] = _common
    """(prepared, networks, config) -> the networks that learn; values are in units of rewards
    times config.sac.reward_scale."""
    update: Callable[..., tuple[sac.AgentState, jax.Array, dict[str, jax.Array]]] = sac.update
    """(networks, agent, batch [B], key, config) -> agent, td_error [B], metrics."""
