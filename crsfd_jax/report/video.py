"""Frames to an animated picture."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from crsfd_jax.files import write_atomically


def write_gif(path: Path, frames: Sequence[np.ndarray], seconds_per_frame: float) -> None:
    """Writes frames, uint8 [H, W, 3] each, as a GIF that repeats.

    Raises:
      ValueError: there is no frame.
      OSError: the file cannot be written.
    """
    if not frames:
        raise ValueError("got 0 frames, allowed: at least one; render some first")
    first, *others = (Image.fromarray(frame) for frame in frames)
    write_atomically(
        path,
        lambda stream: first.save(
            stream,
            "GIF",
            save_all=True,
            append_images=others,
            duration=round(seconds_per_frame * 1000),
            loop=0,
        ),
    )
