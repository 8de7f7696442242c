"""The arm, the potential and the contact forces in a browser, by way of mjviser."""

from typing import Any, NamedTuple

import mujoco
import numpy as np

from crsfd_jax.scene.build import GEOMETRY_FIELDS, Scene, model_of
from crsfd_jax.viewer import pose, potential_map

_ABOVE = 8e-4
"""m, of the potential above the mouth."""
_CAMERA = (0.86, -0.42, 0.33)
_NEWTON = 0.01
"""m of an arrow for a newton."""


class Drawing(NamedTuple):
    """Handles of what is in the browser's scene."""

    server: Any
    """viser.ViserServer."""
    arm: Any
    """mjviser.ViserMujocoScene."""
    scene: Scene
    data: mujoco.MjData
    potential: Any
    """The picture at the mouth."""
    goal: Any
    """Handle that a person drags the peg's tip with."""
    name: Any
    """Label of the socket."""


def make(server: Any, scene: Scene, shape: str, potential: np.ndarray) -> Drawing:
    """Puts the scene on a server, with the camera at the socket.

    Args:
      potential: uint8 [n, n, 4], x along columns and y along rows.
    """
    import mjviser

    model = model_of(scene, scene.shapes.index(shape))
    _scale_arrows(model)
    server.scene.set_up_direction("+z")
    server.initial_camera.position = _CAMERA
    server.initial_camera.look_at = np.add(scene.nominal, (-0.01, 0, 0.07))
    server.initial_camera.fov = np.radians(40)
    server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(0, 114, 178))
    arm = mjviser.ViserMujocoScene(server, model, 1)
    arm.camera_tracking_enabled = False
    arm.show_contact_forces = True
    goal = server.scene.add_transform_controls(
        "/goal", 0.08, depth_test=False, line_width=3.0, visible=False
    )
    name = server.scene.add_label(
        "/socket_name", "", position=np.add(scene.nominal, (0.075, -0.075, 0))
    )
    lying = _lay(server, scene, potential)
    drawing = Drawing(server, arm, scene, mujoco.MjData(model), lying, goal, name)
    show_shape(drawing, shape)
    return drawing


def show(drawing: Drawing, at: pose.Pose) -> None:
    """Draws the arm, the socket and the contact forces."""
    pose.put(drawing.arm.mj_model, drawing.data, at, drawing.scene.nominal)
    drawing.arm.update_from_mjdata(drawing.data)


def show_shape(drawing: Drawing, shape: str) -> None:
    """Replaces the peg and its socket."""
    model = drawing.arm.mj_model
    other = model_of(drawing.scene, drawing.scene.shapes.index(shape))
    for name in GEOMETRY_FIELDS:
        getattr(model, name)[:] = getattr(other, name)
    drawing.arm.rebuild_visual_handles()
    drawing.name.text = f"socket {shape.partition('=')[0]}"


def _lay(server: Any, scene: Scene, picture: np.ndarray) -> Any:
    """Lays a picture over the mouth of the nominal socket."""
    return server.scene.add_image(
        "/potential",
        picture,
        potential_map.SIDE,
        potential_map.SIDE,
        cast_shadow=False,
        receive_shadow=False,
        position=np.add(scene.nominal, (0, 0, _ABOVE)),
    )


def _scale_arrows(model: mujoco.MjModel) -> None:
    """Arrows as long as _NEWTON says and 3 mm thick, whatever the scene's own sizes."""
    model.vis.map.force = _NEWTON
    model.stat.meansize = 0.03
