"""Prioritised ring of transitions that never forgets its demonstrations.

Rows 0..D-1 are demonstrations, rows D..D+C-1 a ring that E environments fill in lockstep,
E rows a vector step. Rewards are stored raw; n-step returns are formed when a batch is drawn.
All functions are for one seed. The count of vector steps is the same for all seeds, so it is an
argument (`step`, `in_axes=None` under vmap) and writing stays a slice update in place.

Source: Schaul et al. 2016 (arXiv 1511.05952); Vecerik et al. 2017 (arXiv 1707.08817).
"""

import dataclasses

import flax.struct
import jax
import jax.numpy as jnp

from crsfd_jax import config
from crsfd_jax.types import Transition

BLOCK = 128


@flax.struct.dataclass(kw_only=True)
class ReplayState:
    """Rows, and how likely each is to be drawn."""

    storage: Transition
    """[D+C] rows."""
    priority: jax.Array
    """[D+C, rounded up to blocks] already raised to the exponent; 0 is never drawn."""
    max_priority: jax.Array
    """[] largest so far, given to new rows."""
    num_demos: int = flax.struct.field(pytree_node=False)
    num_envs: int = flax.struct.field(pytree_node=False)


@flax.struct.dataclass(kw_only=True)
class Draw:
    """Where the batches of a vector step lie in the buffer."""

    rows: jax.Array
    """[..., n] int32, the drawn row followed by its successors in time."""
    alive: jax.Array
    """[..., n] bool, the successor belongs to the same stretch of the same episode."""
    weight: jax.Array
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
    weight: jax.Array
    one_step: Backup
    n_step: Backup


def init(
    demos: Transition, num_envs: int, replay: config.Replay, draws_demos: jax.Array | bool = True
) -> ReplayState:
    """Empty ring behind the demonstrations [D]; D may be 0.

    Args:
      num_envs: the capacity is a multiple of it.
      draws_demos: [] whether demonstrations have a priority, to be drawn by.
    """
    num_demos = demos.reward.shape[0]
    num_rows = num_demos + replay.capacity
    demo_priority = (1.0 + replay.demo_bonus) ** replay.priority_exponent
    priority = jnp.zeros(-(-num_rows // BLOCK) * BLOCK)
    priority = priority.at[:num_demos].set(jnp.where(draws_demos, demo_priority, 0.0))

    def pin(rows: jax.Array) -> jax.Array:
        return jnp.zeros((num_rows, *rows.shape[1:]), rows.dtype).at[:num_demos].set(rows)

    return ReplayState(
        storage=jax.tree.map(pin, demos),
        priority=priority,
        max_priority=jnp.asarray(demo_priority if num_demos else 1.0, jnp.float32),
        num_demos=num_demos,
        num_envs=num_envs,
    )


def draws_demos(state: ReplayState) -> jax.Array:
    """[] bool, whether demonstrations, of which there must be some, have a priority."""
    return state.priority[0] > 0


def add(
    state: ReplayState, transition: Transition, valid: jax.Array, step: jax.Array
) -> ReplayState:
    """Writes the rows [E] of vector step `step` (0, 1, ...) over the oldest of the ring.

    Rows that are not valid (the simulation failed) are blanked and can never be drawn.
    """
    start = _ring_start(state, step)

    def write(rows: jax.Array, new: jax.Array) -> jax.Array:
        new = jax.vmap(jnp.where, in_axes=(0, 0, None))(valid, new, jnp.zeros((), new.dtype))
        return jax.lax.dynamic_update_slice_in_dim(rows, new.astype(rows.dtype), start, 0)

    storage = jax.tree.map(write, state.storage, transition)
    priority = write(state.priority, jnp.full(valid.shape, state.max_priority))
    return dataclasses.replace(state, storage=storage, priority=priority)


def draw(
    state: ReplayState,
    step: jax.Array,
    key: jax.Array,
    shape: tuple[int, int],
    replay: config.Replay,
) -> Draw:
    """Draws all batches [U, B] of vector step `step`, whose rows were added before.

    The importance weight (N P)^-b over its maximum in the batch is (p / min p)^-b for
    P = p / sum p: the number of rows N and the sum cancel. Some row must have a priority.
    """
    rows = draw_rows(state.priority, key, shape)
    window, alive = follow(state, step, rows, replay.n_step)
    priority = state.priority[rows]
    weight = (priority / priority.min(axis=-1, keepdims=True)) ** -replay.importance_exponent
    return Draw(rows=window, alive=alive, weight=weight)


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
        weight=draw.weight,
        one_step=_backup(state, draw.rows[..., :1], draw.alive[..., :1], rewards, gamma),
        n_step=_backup(state, draw.rows, draw.alive, rewards, gamma),
    )


def reprioritise(
    state: ReplayState, draw: Draw, td_error: jax.Array, replay: config.Replay
) -> ReplayState:
    """Sets the priority of the drawn rows from their td_error [U, B].

    (|td_error| + floor + bonus * is_demo)^a. The exponent 0.6 matches the 0.3 of Vecerik et
    al., who square the error; their term for the action gradient is left out. Of a row drawn
    more than once the largest error counts; one that is not finite leaves the row as it was.
    """
    rows, error = draw.rows[..., 0].reshape(-1), jnp.abs(td_error).reshape(-1)
    bonus = replay.priority_floor + replay.demo_bonus * (rows < state.num_demos)
    priority = (error + bonus) ** replay.priority_exponent
    priority = jnp.where(jnp.isfinite(error), priority, state.priority[rows])
    return dataclasses.replace(
        state,
        priority=state.priority.at[rows].set(0.0).at[rows].max(priority),
        max_priority=jnp.maximum(state.max_priority, jnp.max(priority)),
    )


def draw_rows(priority: jax.Array, key: jax.Array, shape: tuple[int, int]) -> jax.Array:
    """Draws rows in proportion to their priority: a block first, then a row inside it.

    Two levels, each with its own random number: one float32 cumulative sum over 3e5 rows is
    not monotone, and one float32 random number has only 28 values a row.
    """
    block_key, row_key = jax.random.split(key)
    blocks = priority.reshape(-1, BLOCK)
    block = _pick(blocks.sum(axis=-1), jax.random.uniform(block_key, shape).reshape(-1))
    row = jax.vmap(_pick)(blocks[block], jax.random.uniform(row_key, block.shape))
    return (block * BLOCK + row).reshape(shape)


def _pick(mass: jax.Array, uniform: jax.Array) -> jax.Array:
    """Index [...] drawn in proportion to mass [W] by inverting its cumulative sum.

    The sum of an empty entry is held at the one before it, and the argument below the total,
    so that rounding never draws an empty entry.
    """
    cumulative = jax.lax.cummax(jnp.where(mass > 0, jnp.cumsum(mass), 0.0))
    total = cumulative[-1]
    argument = jnp.minimum(uniform * total, jnp.nextafter(total, 0.0))
    return jnp.searchsorted(cumulative, argument, side="right")


def follow(
    state: ReplayState, step: jax.Array, rows: jax.Array, length: int
) -> tuple[jax.Array, jax.Array]:
    """Rows [..., length] from `rows` on in time, and which belong to the same episode."""
    window, alive = [rows], [jnp.ones(rows.shape, bool)]
    for _ in range(length - 1):
        last = window[-1]
        ended = state.storage.terminated[last] | state.storage.truncated[last]
        window.append(_successor(state, last))
        goes_on = ~ended & ~_is_newest(state, step, last) & (state.priority[window[-1]] > 0)
        alive.append(alive[-1] & goes_on)
    return jnp.stack(window, axis=-1), jnp.stack(alive, axis=-1)


def _successor(state: ReplayState, rows: jax.Array) -> jax.Array:
    ring = (rows - state.num_demos + state.num_envs) % _capacity(state)
    return jnp.where(rows < state.num_demos, rows + 1, state.num_demos + ring)


def _is_newest(state: ReplayState, step: jax.Array, rows: jax.Array) -> jax.Array:
    """Whether no row follows yet: the rows of `step`, and the last demonstration."""
    offset = rows - _ring_start(state, step)
    return (rows == state.num_demos - 1) | ((offset >= 0) & (offset < state.num_envs))


def _ring_start(state: ReplayState, step: jax.Array) -> jax.Array:
    slot = step % (_capacity(state) // state.num_envs)
    return state.num_demos + slot * state.num_envs


def _capacity(state: ReplayState) -> int:
    return state.storage.reward.shape[0] - state.num_demos


def _backup(
    state: ReplayState, rows: jax.Array, alive: jax.Array, rewards: jax.Array, gamma: float
) -> Backup:
    rewards = jnp.where(alive, rewards[..., : rows.shape[-1]], 0.0)
    steps = jnp.sum(alive, axis=-1)
    last = jnp.take_along_axis(rows, steps[..., None] - 1, axis=-1).squeeze(-1)
    return Backup(
        reward=jnp.sum(rewards * gamma ** jnp.arange(rows.shape[-1]), axis=-1),
        next_obs=state.storage.next_obs[last],
        terminated=state.storage.terminated[last],
        length=steps,
    )
