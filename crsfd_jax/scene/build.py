"""MJCF files and digit solids become one compiled model that serves every shape.

The model holds as many peg and socket primitives as the largest shape needs; a shape is a row of
the geometry tables, which engines write into their models per environment. Surplus primitives are
points parked where nothing can touch them.
"""

import functools
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from crsfd_jax import config
from crsfd_jax.scene import digits

GEOMETRY_FIELDS = ("geom_size", "geom_pos", "geom_rbound", "geom_aabb")
"""The MjModel fields that differ between shapes."""
_PARKED = 1e-4
_KINDS = ("peg_box", "peg_corner", "socket_box", "socket_rim")


class Scene(NamedTuple):
    """A compiled model with what its users look up by name."""

    model: mujoco.MjModel
    """Compiled for the first shape, without what is only for show and slows a step down."""
    look: mujoco.MjModel
    """The same with the arm's shells, the table and the light in the hole, for pictures."""
    shapes: tuple[str, ...]
    """Names of the rows of the geometry tables."""
    geometry: dict[str, np.ndarray]
    """Field name -> [shapes, ...] values of that MjModel field."""
    part_geoms: np.ndarray
    """[G] ids of the peg's and socket's geoms, whose friction an environment sets."""
    look_parts: np.ndarray
    """[G] ids of the same in `look`."""
    nominal: np.ndarray
    """[3] nominal socket mouth in the world, m."""
    tip_site: int
    """Id of the site at the peg's tip."""


def mjcf_folder() -> Path:
    """Folder of the MJCF files: beside the package in a checkout, inside it when installed."""
    installed = Path(str(resources.files("crsfd_jax"))) / "mjcf"
    return installed if installed.is_dir() else installed.parents[1] / "mjcf"


def build(parts: config.Scene, shapes: tuple[str, ...] = config.SHAPES) -> Scene:
    """Compiles the scene for a tuple of shapes, once.

    Raises:
      ValueError: the compiled models differ in more than the geometry fields.
    """
    return _build(parts, shapes)


@functools.cache
def _build(parts, shapes):
    solids = [digits.solids(shape, parts.footprint, parts.clearance) for shape in shapes]
    columns = zip(*map(_groups, solids), strict=True)
    counts = tuple(max(len(group) for group in column) for column in columns)
    models = [_compile(solid, counts) for solid in solids]
    _check_equal(models)
    model = models[0]
    bodies = [model.body(name).id for name in ("peg", "socket")]
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
    look = _compile(solids[0], counts, discardvisual=False)
    return Scene(
        model=model,
        look=look,
        shapes=shapes,
        geometry={f: np.stack([getattr(m, f) for m in models]) for f in GEOMETRY_FIELDS},
        part_geoms=geoms,
        look_parts=np.array([look.geom(model.geom(geom).name).id for geom in geoms]),
        nominal=model.site("nominal").pos.copy(),
        tip_site=model.site("tip").id,
    )


def model_of(scene: Scene, shape: int) -> mujoco.MjModel:
    """A copy of the model with the geometry of one shape, for rendering and inspection."""
    model = scene.look.__copy__()
    for name, table in scene.geometry.items():
        getattr(model, name)[scene.look_parts] = table[shape, scene.part_geoms]
    return model


def place_socket(
    data: mujoco.MjData, scene: Scene, offset: ArrayLike, yaw: ArrayLike | None = None
) -> None:
    """Moves a simulation's socket from the nominal place by [2] m and [] rad about the vertical."""
    half = 0.0 if yaw is None else np.asarray(yaw, float) / 2
    data.mocap_pos[0] = scene.nominal + np.append(offset, 0.0)
    data.mocap_quat[0] = np.cos(half), 0.0, 0.0, np.sin(half)


def _groups(solids):
    return solids.peg_boxes, solids.peg_corners, solids.socket_boxes, solids.socket_rims


def _compile(solids, counts, discardvisual=True):
    spec = mujoco.MjSpec.from_file(str(mjcf_folder() / "insertion.xml"))
    spec.compiler.discardvisual = discardvisual
    hand = spec.body("hand")
    # Turned half around x, the peg's frame is the socket's when the hand points straight down.
    grasp = spec.site("grasp").pos
    peg = hand.add_body(
        name="peg",
        pos=[grasp[0], grasp[1], grasp[2] + digits.PEG_LENGTH - digits.GRIP_LENGTH],
        quat=[0, 1, 0, 0],
        gravcomp=1,
        explicitinertial=True,
        mass=0.1,
        ipos=[0, 0, digits.PEG_LENGTH / 2],
        inertia=[3e-5, 3e-5, 3e-5],
    )
    peg.add_site(name="tip", group=4)
    for kind, rows, count in zip(_KINDS, _groups(solids), counts, strict=True):
        body = peg if kind.startswith("peg") else spec.body("socket")
        _add_geoms(spec, body, kind, rows, count)
    return spec.compile()


def _add_geoms(spec, body, kind, rows, count):
    under_floor = -(digits.HOLE_DEPTH + digits.BLOCK_HEIGHT) / 2
    parked = [0, 0, digits.PEG_LENGTH if kind.startswith("peg") else under_floor]
    for i in range(count):
        used = i < len(rows)
        position = rows[i][:3] if used else parked
        geom = body.add_geom(spec.find_default(kind), name=f"{kind}{i}", pos=position)
        if kind.endswith("box"):
            geom.size = rows[i][3:] if used else [_PARKED] * 3
        else:
            geom.size = [digits.CORNER_RADIUS if used else _PARKED, 0, 0]


def _check_equal(models):
    """Everything but the geometry tables must agree, or a shape would silently be wrong.

    Bounding volume trees may differ too: midphase is off, and broadphase reads only their roots,
    which for the first model must enclose those of the others.
    """
    first = models[0]
    for name in (n for n in dir(first) if isinstance(getattr(first, n), np.ndarray)):
        differs = any(not np.array_equal(getattr(first, name), getattr(m, name)) for m in models)
        if differs and name not in GEOMETRY_FIELDS and not name.startswith("bvh_"):
            raise ValueError(f"{name} differs between shapes; only {GEOMETRY_FIELDS} may")
    for body in ("peg", "socket"):
        sides = zip(*(_bounds(model, body) for model in models), strict=True)
        low, high = (np.stack(side) for side in sides)
        if (low[0] > low.min(axis=0) + 1e-9).any() or (high[0] < high.max(axis=0) - 1e-9).any():
            raise ValueError(f"the {body} of the first shape must enclose those of the others")


def _bounds(model, body):
    root = model.bvh_aabb[model.body_bvhadr[model.body(body).id]]
    return root[:3] - root[3:], root[:3] + root[3:]
