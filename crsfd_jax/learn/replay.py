"""Prioritised ring of transitions that never forgets its demonstrations.

Rows 0..D-1 are demonstrations, rows D..D+C-1 a ring that E environments fill in lockstep,
E rows a vector step. Rewards are stored raw; n-step returns are formed when a batch is drawn.
All functions are for one seed. The number of vector steps is the same for all seeds, so it is
an argument (`step`, `in_axes=None` under vmap) and writing stays a slice update in place.

Source: Schaul et al. 2016 (arXiv 1511.05952); Vecerik et al. 2017 (arXiv 1707.08817).
"""

from __future__ import annotations

import flax.struct
import jax
import jax.numpy as jnp

from crsfd_jax import config
from crsfd_jax.types import Transition

BLOCK = 128
"""Rows whose priorities are summed before drawing; tuned by bench/update.py."""


@flax.struct.dataclass(kw_only=True)
class ReplayState:
    """Rows, and how likely each is to be drawn."""

    storage: Transition
    """[D+C] rows."""
    weight: jax.Array
    """[D+C, rounded up to blocks] priority raised to the exponent; 0 is never drawn."""
    max_weight: jax.Array
    """[] largest weight so far, given to new rows."""
    num_demos: int = flax.struct.field(pytree_node=False)
    num_envs: int = flax.struct.field(pytree_node=False)


@flax.struct.dataclass(kw_only=True)
class Draw:
    """Where the batches of a vector step lie in the buffer."""

    rows: jax.Array
    """[..., n] int32, the drawn row followed by its successors in time."""
    alive: jax.Array
    """[..., n] bool, the successor belongs to the same stretch of the same episode."""
    importance: jax.Array
    """[...] importance weight, at most 1 in each batch."""


@flax.struct.dataclass(kw_only=True)
class Backup:
    """What the value of a state is bootstrapped from, some steps later."""

    reward: jax.Array
    """[...] discounted sum of rewards on the way."""
    next_obs: jax.Array
    """[..., O] observation at the end."""
    terminated: jax.Array
    """[...] bool, the end is terminal: no bootstrap."""
    length: jax.Array
    """[...] int32, steps on the way, at least 1."""


@flax.struct.dataclass(kw_only=True)
class Batch:
    """Training batch; `...` is [U, B] when drawn and [B] in an update."""

    obs: jax.Array
    action: jax.Array
    is_demo: jax.Array
    importance: jax.Array
    one_step: Backup
    n_step: Backup


def init(demos: Transition, num_envs: int, replay: config.Replay) -> ReplayState:
    """Empty ring behind the demonstrations [D]; D may be 0.

    Raises:
      ValueError: the capacity is less than one vector step.
    """
    num_demos = demos.reward.shape[0]
    capacity = replay.capacity // num_envs * num_envs
    if capacity == 0:
        raise ValueError(
            f"replay.capacity is {replay.capacity} but a vector step writes {num_envs} rows; "
            f"raise it to {num_envs} or more"
        )
    num_rows = num_demos + capacity
    demo_weight = (1.0 + replay.demo_bonus) ** replay.priority_exponent
    weight = jnp.zeros(-(-num_rows // BLOCK) * BLOCK).at[:num_demos].set(demo_weight)
    return ReplayState(
        storage=jax.tree.map(
            lambda x: jnp.zeros((num_rows, *x.shape[1:]), x.dtype).at[:num_demos].set(x), demos
        ),
        weight=weight,
        max_weight=jnp.asarray(demo_weight if num_demos else 1.0, jnp.float32),
        num_demos=num_demos,
        num_envs=num_envs,
    )


def add(
    state: ReplayState, transition: Transition, valid: jax.Array, step: jax.Array
) -> ReplayState:
    """Writes the rows [E] of vector step `step` (0, 1, ...) over the oldest of the ring.

    Rows that are not valid (the simulation failed) are blanked and can never be drawn.
    """
    start = _ring_start(state, step)
    clean = jax.tree.map(lambda x: jnp.where(_expand(valid, x), x, jnp.zeros_like(x)), transition)
    storage = jax.tree.map(
        lambda rows, new: jax.lax.dynamic_update_slice_in_dim(
            rows, new.astype(rows.dtype), start, axis=0
        ),
        state.storage,
        clean,
    )
    weight = jax.lax.dynamic_update_slice_in_dim(
        state.weight, jnp.where(valid, state.max_weight, 0.0), start, axis=0
    )
    return state.replace(storage=storage, weight=weight)


def draw(
    state: ReplayState,
    step: jax.Array,
    key: jax.Array,
    shape: tuple[int, int],
    replay: config.Replay,
) -> Draw:
    """Draws all batches [U, B] of vector step `step`, whose rows were added before.

    The importance weight (N P)^-b over its maximum in the batch is (w / min w)^-b for
    P = w / sum w: the number of rows N and the sum cancel.
    """
    rows = _draw_rows(state.weight, key, shape)
    window, alive = _follow(state, step, rows, replay.n_step)
    weight = state.weight[rows]
    smallest = jnp.min(weight, axis=-1, keepdims=True)
    importance = (weight / smallest) ** -replay.importance_exponent
    return Draw(rows=window, alive=alive, importance=importance)


def gather(state: ReplayState, draw: Draw, rewards: jax.Array, gamma: float) -> Batch:
    """Reads the drawn batches.

    Args:
      rewards: [..., n] reward of every row of `draw.rows`: `state.storage.reward[draw.rows]`,
        or what a method puts in its place.
    """
    rows = draw.rows[..., 0]
    return Batch(
        obs=state.storage.obs[rows],
        action=state.storage.action[rows],
        is_demo=rows < state.num_demos,
        importance=draw.importance,
        one_step=_backup(state, draw.rows[..., :1], draw.alive[..., :1], rewards, gamma),
        n_step=_backup(state, draw.rows, draw.alive, rewards, gamma),
    )


def reprioritise(
    state: ReplayState, draw: Draw, td_error: jax.Array, replay: config.Replay
) -> ReplayState:
    """Weights the drawn rows anew by their td_error [U, B].

    priority = |td_error| + floor + bonus * is_demo, so exponent 0.6 corresponds to the 0.3 of
    Vecerik et al., who square the error; their term for the action gradient is left out. Of
    a row drawn more than once the largest error counts, which does not depend on the order.
    A td_error that is not finite leaves its row as it was.
    """
    rows = draw.rows[..., 0].reshape(-1)
    is_demo = rows < state.num_demos
    priority = jnp.abs(td_error).reshape(-1) + replay.priority_floor + replay.demo_bonus * is_demo
    weight = priority**replay.priority_exponent
    weight = jnp.where(jnp.isfinite(weight), weight, state.weight[rows])
    return state.replace(
        weight=state.weight.at[rows].set(0.0).at[rows].max(weight),
        max_weight=jnp.maximum(state.max_weight, jnp.max(weight)),
    )


def _draw_rows(weight: jax.Array, key: jax.Array, shape: tuple[int, int]) -> jax.Array:
    """Draws rows in proportion to their weight: a block first, then a row inside it.

    Two levels, each with its own random number: one float32 cumulative sum over 3e5 rows is
    not monotone, and one float32 random number has only 28 values a row.
    """
    block_key, row_key = jax.random.split(key)
    blocks = weight.reshape(-1, BLOCK)
    block = _pick(blocks.sum(axis=-1), jax.random.uniform(block_key, shape).reshape(-1))
    row = jax.vmap(_pick)(blocks[block], jax.random.uniform(row_key, shape).reshape(-1))
    return (block * BLOCK + row).reshape(shape)


def _pick(weight: jax.Array, uniform: jax.Array) -> jax.Array:
    """Index [...] drawn in proportion to weight [W] by inverting its cumulative sum.

    The sum of an empty entry is held at the one before it, and the argument below the total,
    so that rounding never draws an empty entry.
    """
    cumulative = jax.lax.cummax(jnp.where(weight > 0, jnp.cumsum(weight), 0.0))
    total = cumulative[-1]
    argument = jnp.minimum(uniform * total, jnp.nextafter(total, 0.0))
    return jnp.searchsorted(cumulative, argument, side="right")


def _follow(
    state: ReplayState, step: jax.Array, rows: jax.Array, length: int
) -> tuple[jax.Array, jax.Array]:
    """Rows [..., length] from `rows` on in time, and which of them are still the episode."""
    window, alive = [rows], [jnp.ones(rows.shape, bool)]
    for _ in range(length - 1):
        last = window[-1]
        ended = state.storage.terminated[last] | state.storage.truncated[last]
        following = _successor(state, last)
        window.append(following)
        goes_on = ~ended & ~_is_newest(state, step, last) & (state.weight[following] > 0)
        alive.append(alive[-1] & goes_on)
    return jnp.stack(window, axis=-1), jnp.stack(alive, axis=-1)


def _successor(state: ReplayState, rows: jax.Array) -> jax.Array:
    ring = (rows - state.num_demos + state.num_envs) % _capacity(state)
    # The row after the last demonstration is clipped: it counts as the newest, so none follows.
    demo = jnp.minimum(rows + 1, state.num_demos - 1)
    return jnp.where(rows < state.num_demos, demo, state.num_demos + ring)


def _is_newest(state: ReplayState, step: jax.Array, rows: jax.Array) -> jax.Array:
    start = _ring_start(state, step)
    return (rows == state.num_demos - 1) | ((rows >= start) & (rows < start + state.num_envs))


def _ring_start(state: ReplayState, step: jax.Array) -> jax.Array:
    slot = step % (_capacity(state) // state.num_envs)
    return state.num_demos + slot * state.num_envs


def _capacity(state: ReplayState) -> int:
    return state.storage.reward.shape[0] - state.num_demos


def _backup(
    state: ReplayState, rows: jax.Array, alive: jax.Array, rewards: jax.Array, gamma: float
) -> Backup:
    length = rows.shape[-1]
    discounts = gamma ** jnp.arange(length)
    steps = jnp.sum(alive, axis=-1)
    last = jnp.take_along_axis(rows, steps[..., None] - 1, axis=-1).squeeze(-1)
    return Backup(
        reward=jnp.sum(jnp.where(alive, rewards[..., :length], 0.0) * discounts, axis=-1),
        next_obs=state.storage.next_obs[last],
        terminated=state.storage.terminated[last],
        length=steps,
    )


def _expand(mask: jax.Array, like: jax.Array) -> jax.Array:
    return mask.reshape(mask.shape + (1,) * (like.ndim - mask.ndim))
