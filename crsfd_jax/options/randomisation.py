"""What tells a real arm and its task from their model, as options: drawn anew for every episode.

Ranges are written low high, or low high low high for two of them, each as likely as it is wide.
"""

from dataclasses import dataclass
from typing import Annotated

from crsfd_jax.options.field_types import Factors, Fraction, Length
from crsfd_jax.options.limits import Interval, Ranges


@dataclass(frozen=True)
class Randomisation:
    """What a real arm adds to its model; nothing by default.

    Ranges are written low high, or low high low high for two of them.
    """

    friction: Factors = (1.0, 1.0)
    """Factor on --scene.friction."""
    socket_yaw: Annotated[tuple[float, ...], Interval(-0.15, 0.15), Ranges()] = (0.0, 0.0)
    """Rotation of the socket about the vertical that the arm does not know of, rad; setpoints turn
    as far."""
    stiffness: Factors = (1.0, 1.0)
    """Factor on the stiffness of the impedance controller."""
    damping: Annotated[tuple[float, ...], Interval(0, 3, open="low"), Ranges()] = (1.0, 1.0)
    """Factor on its damping; from 4 on the physics steps are too long for it."""
    delay: Fraction = 0.0
    """Share of episodes in which every setpoint takes effect one control step late."""
    encoder_offset: Annotated[tuple[float, ...], Interval(-0.1, 0.1), Ranges()] = (0.0, 0.0)
    """Error of each joint's calibration, rad, constant through an episode."""
    position_noise: Annotated[Length, Interval(0, 0.01)] = 0.0
    """Standard deviation of each reading of the tip's position along each axis."""
    rotation_noise: Annotated[float, Interval(0, 0.1)] = 0.0
    """Standard deviation of each reading of the tip's rotation about each axis, rad."""


TRAINING = Randomisation(
    friction=(1.0, 2.0),
    stiffness=(0.9, 1.1),
    damping=(0.8, 1.2),
    delay=0.5,
    encoder_offset=(-1e-3, -7e-4, -4e-4, 4e-4, 7e-4, 1e-3),
    position_noise=2e-4,
    rotation_noise=1e-3,
)
"""Ranges to train with for a transfer. Friction: Guo et al. 2022. 1e-3 rad in seven joints is some
0.8 mm at the tip, between the 0.2 mm left by a careful calibration of this arm and the 10 mm
without any (Franzese et al. 2025, arXiv 2503.12584). The rest is a guess: a tenth of the gains, and
noise of a tenth of a full action at most."""
HELD_OUT = Randomisation(
    friction=(0.6, 1.0, 2.0, 2.4),
    stiffness=(0.8, 0.9, 1.1, 1.2),
    damping=(0.6, 0.8, 1.2, 1.4),
    delay=0.5,
    encoder_offset=(-7e-4, -4e-4, 4e-4, 7e-4),
    position_noise=3e-4,
    rotation_noise=1.5e-3,
)
"""Ranges unlike those of TRAINING, as many delays, and more noise.

Friction and gains lie beyond those of TRAINING, joint offsets in its gap: a policy cannot search
further than it ever had to, so errors of place must be met in training as large as the arm's."""
