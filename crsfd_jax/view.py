"""Shows a run in a browser, films it, or draws a task.

python -m crsfd_jax.view RUN                     the policies act in a browser
python -m crsfd_jax.view RUN --video out.mp4     episodes as a film
python -m crsfd_jax.view --shape 2 --png out.png   the arm, a peg and its socket
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from crsfd_jax import cli, config
from crsfd_jax.drawing import opengl
from crsfd_jax.errors import UserError
from crsfd_jax.options import field_types, shapes, validation
from crsfd_jax.options.limits import Interval
from crsfd_jax.storage import artefacts
from crsfd_jax.storage.files import output, write_atomically


@dataclass(frozen=True)
class View:
    """Shows the policies of a run in a browser, films them, or draws a task."""

    run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")] = ""
    """Folder of the run to watch or film; without one, a picture of the task is drawn."""
    shape: field_types.Shape | None = None
    """Peg and socket: 0, 1, 2, 3, 4 or a text file with a grid of # and . for cells; the run's own
    if not given, or 2."""
    shift: field_types.Shift | None = None
    """Side of the square of socket offsets, such as 8mm; the run's own if not given, or 0."""
    png: str | None = None
    """Picture to write when no run is given, scene.png if not named; the socket is drawn in a
    corner of the square."""
    video: str = ""
    """Film of the run to write, .mp4 or .gif, instead of the browser."""
    episodes: Annotated[int, Interval(1, 1000)] = 3
    """Episodes in the film."""
    host: str = "127.0.0.1"
    """Address to serve the page on; 0.0.0.0 shows it to the whole network."""
    port: Annotated[int, Interval(1, 65_535)] = 8080
    """Port to serve the page on."""
    scene: config.Scene = field(default_factory=config.Scene)
    """For the picture without a run."""


def main(argv: list[str]) -> None:
    """Shows, films or draws what a command line asks for.

    Raises:
      UserError: an option cannot be used, OpenGL or an extra is missing, or a file cannot be
        written.
    """
    view = cli.parse(View, argv)
    validation.validate(_options(view))
    if view.shape and view.shape not in (shown := shapes.read(view.shape)):
        raise UserError(
            f"--shape: got {view.shape!r}, allowed here: one shape; choose one, such as {shown[0]}"
        )
    if view.video and not view.run:
        raise UserError("--video: got no run to film; write its folder, view RUN --video out.mp4")
    for option, given in (("--png", view.png), ("--scene", view.scene != config.Scene())):
        if view.run and given:
            raise UserError(f"{option}: got the run {view.run} as well, allowed: one of them")
    if view.episodes != View.episodes and not view.video:
        raise UserError(
            f"--episodes: got {view.episodes} without a film, allowed with --video; add it"
        )
    for option in ("host", "port"):
        if getattr(view, option) != getattr(View, option) and (view.video or not view.run):
            raise UserError(f"--{option}: got no page to serve, allowed: view RUN; leave it out")
    if not view.run:
        _draw(view, view.png or "scene.png")
    elif view.video:
        opengl.platform()
        from crsfd_jax.viewer import film

        print(film.make(view.run, view.shape, view.shift, view.episodes, Path(view.video)))
    else:
        artefacts.read_config(view.run)
        from crsfd_jax.viewer import serve

        serve.watch(view.run, view.shape, view.shift, view.host, view.port)


def _options(view: View) -> config.Config:
    """What is drawn when there is no run."""
    return config.Config(
        shape=view.shape or config.Config.shape, shift=view.shift or 0.0, scene=view.scene
    )


def _draw(view: View, png: str) -> None:
    if Path(png).suffix != ".png":
        raise UserError(f"--png: got {png!r}, allowed: a name that ends in .png; choose one")
    opengl.platform()
    # Imported late: a bad command line is answered at once, and mujoco needs its OpenGL known.
    from PIL import Image

    from crsfd_jax import task
    from crsfd_jax.drawing.overview import overview

    options = _options(view)
    scene = task.scene_of(options)
    picture = Image.fromarray(overview(scene, scene.shapes.index(options.shape), options.shift))
    with output(png, "--png"):
        write_atomically(Path(png), lambda stream: picture.save(stream, "PNG"))
    print(f"wrote {png}")


if __name__ == "__main__":
    cli.main(main)
