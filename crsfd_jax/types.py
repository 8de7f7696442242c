"""The records that cross module borders.

Shape letters used everywhere: S seeds, E environments, D demonstration transitions,
B batch, U updates, O observation size, A action size.
"""

import flax.struct
import jax


@flax.struct.dataclass(kw_only=True)
class Transition:
    """One environment step, with the raw sparse reward; leading axes are free."""

    obs: jax.Array
    """[..., O] observation before the action."""
    action: jax.Array
    """[..., A] in [-1, 1]."""
    reward: jax.Array
    """[...] 1 at full insertion, else 0."""
    next_obs: jax.Array
    """[..., O] observation after the action and before any reset."""
    terminated: jax.Array
    """[...] bool, the peg is fully inserted: no bootstrap."""
    truncated: jax.Array
    """[...] bool, the time limit was hit: the episode ends, the value goes on."""
