"""Frames to an animated picture or a film."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from crsfd_jax import extras
from crsfd_jax.errors import UserError
from crsfd_jax.storage.files import write_atomically

SUFFIXES = (".gif", ".mp4")


def check_name(path: Path) -> None:
    """Refuses what cannot be written, before any time is spent on frames.

    Raises:
      UserError: the name has another ending, the folder is missing, or an extra is.
    """
    if path.suffix not in SUFFIXES:
        raise UserError(
            f"--video: got {str(path)!r}, allowed: names that end in {' or '.join(SUFFIXES)}; "
            "choose one"
        )
    if not path.absolute().parent.is_dir():
        raise UserError(f"--video: got {str(path)!r}, allowed: a folder that exists; make it first")
    if path.suffix == ".mp4":
        extras.require("mp4 films", "video", "imageio", "imageio_ffmpeg")


def write(path: Path, frames: Sequence[np.ndarray], seconds_per_frame: float) -> None:
    """Writes frames, uint8 [H, W, 3] each with even H and W, as the name's ending says.

    Raises:
      ValueError: there is no frame.
      OSError: the file cannot be written.
    """
    if not frames:
        raise ValueError("got 0 frames, allowed: at least one; render some first")
    form = _write_mp4 if path.suffix == ".mp4" else _write_gif
    form(path, frames, seconds_per_frame)


def _write_mp4(path: Path, frames: Sequence[np.ndarray], seconds_per_frame: float) -> None:
    """An H.264 film that every browser plays."""
    import imageio.v3

    with warnings.catch_warnings():
        # JAX warns of every fork; this one becomes ffmpeg at once.
        warnings.filterwarnings("ignore", r"os\.fork", RuntimeWarning)
        film = imageio.v3.imwrite(
            "<bytes>",
            np.stack(frames),
            extension=".mp4",
            plugin="FFMPEG",
            fps=1 / seconds_per_frame,
            codec="libx264",
            macro_block_size=2,
            quality=7,
        )
    write_atomically(path, lambda stream: stream.write(film))


def _write_gif(path: Path, frames: Sequence[np.ndarray], seconds_per_frame: float) -> None:
    """A picture that repeats."""
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
