"""Draws a task: python -m crsfd_jax.view --shape 2 --png out.png"""

from dataclasses import dataclass, field
from pathlib import Path

from crsfd_jax import cli, config, validation
from crsfd_jax.errors import UserError
from crsfd_jax.files import write_atomically
from crsfd_jax.report import opengl


@dataclass(frozen=True)
class View:
    """Draws the arm, a peg and its socket into a picture file."""

    shape: str = config.Config.shape
    """Digit of the peg and its socket: 0, 1, 2, 3 or 4."""
    shift: config.Length = config.Config.shift
    """Side of the square of socket offsets; the socket is drawn in a corner of it."""
    png: str = "scene.png"
    """File to write."""
    scene: config.Scene = field(default_factory=config.Scene)


def main(argv: list[str]) -> None:
    """Writes the picture that a command line asks for.

    Raises:
      UserError: an option cannot be used, OpenGL is missing or the file cannot be written.
    """
    view = cli.parse(View, argv)
    validation.validate(config.Config(shape=view.shape, shift=view.shift, scene=view.scene))
    opengl.platform()
    # Imported late: a bad command line is answered at once, and mujoco needs its OpenGL known.
    from PIL import Image

    from crsfd_jax.report.overview import overview
    from crsfd_jax.scene.build import build

    scene = build(view.scene)
    picture = Image.fromarray(overview(scene, scene.shapes.index(view.shape), view.shift))
    try:
        write_atomically(Path(view.png), lambda stream: picture.save(stream, "PNG"))
    except OSError as error:
        raise UserError(
            f"--png: got {view.png!r}, allowed: a file in a folder that exists and can be "
            f"written; choose another ({error.strerror})"
        ) from None
    print(f"wrote {view.png}")


if __name__ == "__main__":
    cli.main(main)
