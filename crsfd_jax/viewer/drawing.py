"""The arm, the potential and the contact forces in a browser, by way of mjviser."""

from typing import Any, NamedTuple

import mujoco
import numpy as np

from crsfd_jax.scene.build import GEOMETRY_FIELDS, Scene, model_of
from crsfd_jax.viewer import pose, potential_map

_ABOVE = 8e-4
"""m, of the potential above the mouth."""
_CAMERA = (0.86, -0.42, 0.33)
_NEWTON = 0.02
"""m of an arrow for a newton."""
_PEG_OPACITY = 0.6
"""While contact forces are shown: their arrows point into the peg."""


class Drawing(NamedTuple):
    """Handles of what is in the browser's scene."""

    server: Any
    """viser.ViserServer."""
    arm: Any
    """mjviser.ViserMujocoScene."""
    scene: Scene
    data: mujoco.MjData
    peg: Any
    """Its boxes."""
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
    model.geom_rgba[_peg_boxes(model), 3] = 0.0
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
    peg, lying = _add_peg(server, model), _lay(server, scene, potential)
    drawing = Drawing(server, arm, scene, mujoco.MjData(model), peg, lying, goal, name)
    show_shape(drawing, shape)
    return drawing


def show(drawing: Drawing, at: pose.Pose) -> None:
    """Draws the arm, the peg, the socket and the contact forces."""
    model, data = drawing.arm.mj_model, drawing.data
    pose.put(model, data, at, drawing.scene)
    drawing.arm.update_from_mjdata(data)
    boxes = _peg_boxes(model)
    drawing.peg.batched_positions = data.geom_xpos[boxes]
    drawing.peg.batched_wxyzs = np.tile(data.body("peg").xquat, (len(boxes), 1))


def show_forces(drawing: Drawing, wanted: bool) -> None:
    """Shows the contact forces and lets the peg be seen through, or neither."""
    drawing.arm.show_contact_forces = wanted
    drawing.peg.opacity = _PEG_OPACITY if wanted else 1.0


def show_shape(drawing: Drawing, shape: str) -> None:
    """Replaces the peg and its socket."""
    model = drawing.arm.mj_model
    other = model_of(drawing.scene, drawing.scene.shapes.index(shape))
    for name in GEOMETRY_FIELDS:
        getattr(model, name)[:] = getattr(other, name)
    drawing.arm.rebuild_visual_handles()
    drawing.peg.batched_scales = model.geom_size[_peg_boxes(model)]
    drawing.name.text = f"socket {shape.partition('=')[0]}"


def _peg_boxes(model: mujoco.MjModel) -> np.ndarray:
    is_box = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    return np.flatnonzero(is_box & (model.geom_bodyid == model.body("peg").id))


def _add_peg(server: Any, model: mujoco.MjModel) -> Any:
    """The peg's boxes, which mjviser would draw opaque."""
    import trimesh

    cube, count = trimesh.creation.box((2, 2, 2)), len(_peg_boxes(model))
    return server.scene.add_batched_meshes_simple(
        "/peg",
        cube.vertices,
        cube.faces,
        batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        batched_positions=np.zeros((count, 3)),
        batched_scales=np.ones((count, 3)),
        # Browsers take the colours of instances for linear light.
        batched_colors=tuple((255 * model.material("peg").rgba[:3] ** 2.2).astype(int)),
        flat_shading=True,
        lod="off",
    )


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
    # MuJoCo draws the forces on the socket, into the block; the minus makes them those on the peg.
    model.vis.map.force = -_NEWTON * model.stat.meanmass
    model.stat.meansize = 0.03
