"""The potential over the plane of the socket's mouth as a picture to lay there."""

from collections.abc import Callable

import matplotlib
import numpy as np

SIDE = 0.1
"""m, of the square that is drawn."""
_PIXELS = 160
_OPACITY = 0.7
COLOURS = "plasma"


def colour(values: np.ndarray) -> np.ndarray:
    """RGBA uint8 [..., 4] of potentials [...] in [0, 1]; low ones are nearly transparent."""
    rgba = matplotlib.colormaps[COLOURS](values)
    rgba[..., 3] = _OPACITY * np.clip(2.5 * np.asarray(values), 0.05, 1.0)
    return (rgba * 255).astype(np.uint8)


def over_mouth(phi: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """uint8 [n, n, 4]: x along columns, y along rows, of the peg upright at the mouth.

    Args:
      phi: potential [...] of poses [..., 6], m and rad in the nominal socket's frame.
    """
    centres = (np.arange(_PIXELS) + 0.5) / _PIXELS * SIDE - SIDE / 2
    poses = np.zeros((_PIXELS, _PIXELS, 6))
    poses[..., 0], poses[..., 1] = centres[None, :], centres[:, None]
    return colour(phi(poses))


def legend() -> np.ndarray:
    """uint8 [12, 240, 3]: the colours from 0 on the left to 1 on the right, on white."""
    rgba = colour(np.broadcast_to(np.linspace(0, 1, 240), (12, 240))).astype(float)
    share = rgba[..., 3:] / 255
    return (rgba[..., :3] * share + 255 * (1 - share)).astype(np.uint8)
