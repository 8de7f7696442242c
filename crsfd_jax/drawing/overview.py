"""One picture of a task: the whole arm, the peg above its socket, and the hole from above."""

import jax.numpy as jnp
import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from crsfd_jax.drawing.picture import render
from crsfd_jax.options.shapes import label
from crsfd_jax.options.units import format_length
from crsfd_jax.scene.build import Scene, model_of, place_socket
from crsfd_jax.scene.kinematics import chain, inverse_kinematics

HEIGHT = 900
"""Pixels of the picture from top to bottom."""
_LOW, _HIGH = 0.04, 0.3
"""m, tip above the mouth: ready to insert, and out of the way of the camera above the hole."""
_INK = (30, 34, 40)
_MARK = (255, 214, 64)


def overview(scene: Scene, shape: int, shift: float) -> np.ndarray:
    """Draws the parts of a shape, the socket in a corner of the square of its possible offsets.

    Args:
      shape: row of the scene's geometry tables.
      shift: side of that square, m.

    Returns:
      uint8 [900, 1500, 3].

    Raises:
      UserError: no OpenGL works on this machine.
    """
    model = model_of(scene, shape)
    low, high = _poses(scene)
    half = HEIGHT // 2
    panels = (
        (_draw(scene, model, low, shift, "scene", HEIGHT, HEIGHT), (0, 0)),
        (_draw(scene, model, low, shift, "close", 600, half), (HEIGHT, 0)),
        (_hole(scene, model, high, shift, 600, half), (HEIGHT, half)),
    )
    canvas = Image.new("RGB", (HEIGHT + 600, HEIGHT))
    for panel, corner in panels:
        canvas.paste(panel, corner)
    draw = ImageDraw.Draw(canvas)
    draw.line([(HEIGHT, 0), (HEIGHT, HEIGHT)], "white", 6)
    draw.line([(HEIGHT, half), (HEIGHT + 600, half)], "white", 6)
    name = label(scene.shapes[shape])
    moved = f", moved by {format_length(shift / 2)} in x and y" if shift else ""
    _label(draw, (24, 20), f"Franka Panda, peg and socket {name}")
    _label(draw, (HEIGHT + 24, half - 44), f"peg {format_length(_LOW)} above mouth")
    _label(draw, (HEIGHT + 24, half + 20), f"socket from above{moved}", "white")
    return np.asarray(canvas)


def _poses(scene):
    """[2, 7] joint angles with the tip upright above the nominal socket, low and high."""
    position = jnp.array([[0, 0, _LOW], [0, 0, _HIGH]])
    qpos, _ = inverse_kinematics(chain(scene), position, jnp.zeros((2, 3)))
    return np.asarray(qpos)


def _draw(scene, model, qpos, shift, camera, width, height):
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    place_socket(data, scene, np.full(2, shift / 2))
    mujoco.mj_forward(model, data)
    return Image.fromarray(render(model, data, camera, width, height))


def _hole(scene, model, qpos, shift, width, height):
    """The view along the socket's axis, marking the nominal centre and the square of offsets."""
    panel = _draw(scene, model, qpos, shift, "hole", width, height)
    if shift:
        camera = model.camera("hole")
        span = 2 * camera.pos[2] * np.tan(np.radians(camera.fovy[0]) / 2)
        reach = shift / 2 * height / span
        x, y = width / 2 - reach, height / 2 + reach
        draw = ImageDraw.Draw(panel)
        draw.rectangle([x - reach, y - reach, x + reach, y + reach], outline=_MARK, width=2)
        draw.line([x - 8, y, x + 8, y], _MARK, 2)
        draw.line([x, y - 8, x, y + 8], _MARK, 2)
        _label(draw, (24, height - 44), "yellow: nominal centre and where the socket may be", _MARK)
    return panel


def _label(draw, corner, text, fill=_INK):
    draw.text(corner, text, fill, ImageFont.load_default(size=22))
