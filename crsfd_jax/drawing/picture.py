"""Off-screen pictures of a scene, on machines with or without a display."""

import contextlib
import importlib
from collections.abc import Callable, Iterator

import mujoco
import numpy as np

from crsfd_jax.drawing import opengl

_HIDDEN_GROUPS = [3, 4]
"""Contact spheres and sites."""
_FACE_GAP = 2e-6
"""m, by which each solid is drawn smaller than the one before: the boxes of a part overlap, and
where their faces coincide light and shadow would flicker between them."""


def render(
    model: mujoco.MjModel, data: mujoco.MjData, camera: str, width: int, height: int
) -> np.ndarray:
    """Draws one picture; see `camera_of`."""
    with camera_of(model, camera, width, height) as draw:
        return draw(data)


@contextlib.contextmanager
def camera_of(
    model: mujoco.MjModel, camera: str, width: int, height: int
) -> Iterator[Callable[[mujoco.MjData], np.ndarray]]:
    """A function that draws what a camera of the model sees, for as long as the block lasts.

    It takes data that are up to date, as after mj_forward, and gives uint8 [height, width, 3].

    Args:
      model: width and height are at most its offwidth and offheight.
      camera: name of a camera.

    Raises:
      UserError: no OpenGL works on this machine.
    """
    window = importlib.import_module(f"mujoco.{opengl.platform()}").GLContext(width, height)
    window.make_current()
    context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    view = mujoco.MjrRect(0, 0, width, height)

    def draw(data: mujoco.MjData) -> np.ndarray:
        pixels = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_render(view, _drawable(model, data, camera), context)
        mujoco.mjr_readPixels(pixels, None, view, context)
        return pixels[::-1].copy()

    try:
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
        yield draw
    finally:
        context.free()
        window.free()


def _drawable(model, data, camera):
    option = mujoco.MjvOption()
    option.geomgroup[_HIDDEN_GROUPS] = 0
    view = mujoco.MjvCamera()
    view.type = mujoco.mjtCamera.mjCAMERA_FIXED
    view.fixedcamid = model.camera(camera).id
    scene = mujoco.MjvScene(model, maxgeom=1000)
    category = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(model, data, option, None, view, category, scene)
    for i, geom in enumerate(scene.geoms[: scene.ngeom]):
        geom.size = np.asarray(geom.size) - i * _FACE_GAP
    return scene
