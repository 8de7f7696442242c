"""What every physics engine takes and gives: one control step of many environments."""

from collections.abc import Callable
from typing import NamedTuple

import flax.struct
import jax


@flax.struct.dataclass(kw_only=True)
class PhysicsState:
    """All that a simulation carries from one control step to the next; N is any leading shape."""

    qpos: jax.Array
    """[N, 7] joint angles, rad."""
    qvel: jax.Array
    """[N, 7] joint velocities, rad/s."""
    warmstart: jax.Array
    """[N, 7] accelerations that start the next constraint solve, rad/s^2."""


@flax.struct.dataclass(kw_only=True)
class Surroundings:
    """What differs between environments of one compiled program."""

    shape: jax.Array
    """[N] int32 row of the scene's geometry tables."""
    socket_offset: jax.Array
    """[N, 2] m, the socket's place in the plane relative to the nominal one."""
    friction: jax.Array
    """[N] sliding friction coefficient between peg and socket."""
    socket_yaw: jax.Array | None = None
    """[N] rad, the socket's rotation about the vertical; None where it is 0."""
    gains: jax.Array | None = None
    """[N, 2] factors on stiffness and damping of the controller; None where they are 1."""
    encoder_offset: jax.Array | None = None
    """[N, 7] rad, what the arm reads less its joint angles; None where it is 0."""
    is_delayed: jax.Array | None = None
    """[N] bool, setpoints take effect one control step late; None where none does."""
    noise_seed: jax.Array | None = None
    """[N] uint32 seed of an episode's readings; None where they are exact."""


@flax.struct.dataclass(kw_only=True)
class Limits:
    """Which limits of the engine a control step met; None where the engine does not tell."""

    contacts: jax.Array | None = None
    """[N] bool, in any physics step contacts or their constraints filled the room for them."""
    solver: jax.Array | None = None
    """[N] bool, in the last physics step the solver made all the iterations that it may."""


class Engine(NamedTuple):
    """A physics engine: pure functions over a fixed scene."""

    name: str
    advance: Callable[[PhysicsState, Surroundings, jax.Array], tuple[PhysicsState, Limits]]
    """(state, surroundings, setpoint [N, 6]) -> state one control step later, limits met.

    The setpoint is the tip's target in the nominal socket's frame: position (m) and rotation
    vector (rad), held for the whole control step. A simulation that breaks down gives NaN.
    """

    def step(self, state: PhysicsState, around: Surroundings, setpoint: jax.Array) -> PhysicsState:
        """The state one control step later."""
        return self.advance(state, around, setpoint)[0]


CONTROL_DT = 0.1
"""s, one control step: 10 Hz (Guo et al. 2022, section 5.1)."""
