"""Digit solids against rasters of the digits, drawn here from the text of the grids."""

import itertools

import numpy as np
import pytest

from crsfd_jax.options import shapes
from crsfd_jax.scene import digits

FOOTPRINT = 0.04
PIXEL = 0.25e-3
EXTENT = 0.024
"""m, half width of a raster: the footprint and 4 mm around it."""
CENTRES = np.arange(-EXTENT + PIXEL / 2, EXTENT, PIXEL)
ALL = pytest.mark.parametrize("shape", sorted(shapes.GRIDS))


def hole_raster(shape):
    """[nx, ny] bool: x to the right and y upwards on the printed digit."""
    rows = shapes.GRIDS[shape]
    pitch = FOOTPRINT / 5
    column = np.floor((CENTRES + FOOTPRINT / 2) / pitch).astype(int)
    row = np.floor((FOOTPRINT / 2 - CENTRES) / pitch).astype(int)
    filled = np.zeros((len(CENTRES), len(CENTRES)), bool)
    for (i, c), (j, r) in itertools.product(enumerate(column), enumerate(row)):
        filled[i, j] = 0 <= c < 5 and 0 <= r < 5 and rows[r][c] == "#"
    return filled


def raster(boxes, height):
    """[nx, ny] bool: pixels whose centres lie in a box at a height (m)."""
    x, y = np.meshgrid(CENTRES, CENTRES, indexing="ij")
    filled = np.zeros(x.shape, bool)
    for cx, cy, cz, hx, hy, hz in boxes:
        if abs(height - cz) < hz:
            filled |= (abs(x - cx) < hx) & (abs(y - cy) < hy)
    return filled


def eroded(filled, pixels):
    """Pixels whose whole square neighbourhood is filled."""
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(filled, pixels, mode="edge"), (2 * pixels + 1, 2 * pixels + 1)
    )
    return windows.all(axis=(2, 3))


def parts(shape, clearance=1e-3):
    return digits.solids(shape, FOOTPRINT, clearance)


@ALL
def test_the_socket_is_the_block_without_the_cells_of_the_digit(shape):
    boxes = parts(shape).socket_boxes
    for depth in (1e-4, digits.HOLE_DEPTH / 2, digits.HOLE_DEPTH - 1e-4):
        np.testing.assert_array_equal(raster(boxes, -depth), ~hole_raster(shape))
    assert raster(boxes, -digits.HOLE_DEPTH - 1e-4).all()
    assert not raster(boxes, 1e-4).any()


@ALL
def test_the_block_reaches_as_far_as_its_width_and_height_say(shape):
    centre, half = np.split(parts(shape).socket_boxes, 2, axis=1)
    wide, tall = digits.BLOCK_HALF_WIDTH, digits.BLOCK_HEIGHT
    np.testing.assert_allclose((centre - half).min(axis=0), [-wide, -wide, -tall], atol=1e-12)
    np.testing.assert_allclose((centre + half).max(axis=0), [wide, wide, 0], atol=1e-12)


@ALL
@pytest.mark.parametrize("pixels", [1, 2, 4])
def test_hole_and_peg_differ_by_half_the_clearance_on_every_side(shape, pixels):
    boxes = parts(shape, clearance=2 * pixels * PIXEL).peg_boxes
    expected = eroded(hole_raster(shape), pixels)
    for height in (1e-4, digits.PEG_LENGTH - 1e-4):
        np.testing.assert_array_equal(raster(boxes, height), expected)
    assert not raster(boxes, -1e-4).any()
    assert not raster(boxes, digits.PEG_LENGTH + 1e-4).any()


@ALL
def test_a_negative_clearance_makes_the_peg_wider_than_its_hole_on_every_side(shape):
    dilated = ~eroded(~hole_raster(shape), 2)
    np.testing.assert_array_equal(raster(parts(shape, -4 * PIXEL).peg_boxes, 0.01), dilated)


@ALL
def test_peg_and_socket_share_no_volume_at_zero_offset(shape):
    solid = parts(shape)
    for peg, wall in itertools.product(solid.peg_boxes, solid.socket_boxes[:-1]):
        gap = np.abs(peg[:2] - wall[:2]) - peg[3:5] - wall[3:5]
        assert gap.max() > 0.5e-3 - 1e-12, "nearer than half the clearance"


@ALL
def test_peg_and_hole_are_not_mirrored_against_each_other(shape):
    fits = parts(shape).peg_boxes
    assert not (raster(fits, 0.01) & raster(parts(shape).socket_boxes, -0.01)).any()
    mirrored = fits * [-1, 1, 1, 1, 1, 1]
    clashes = (raster(mirrored, 0.01) & raster(parts(shape).socket_boxes, -0.01)).any()
    assert clashes == (shape != "0"), "only the zero is its own mirror image"


def convex_vertices(filled):
    """{(x, y) m: (sx, sy) towards the inside} where one of four pixels around is filled."""
    found = {}
    for i, j in itertools.product(range(1, len(CENTRES)), repeat=2):
        block = filled[i - 1 : i + 1, j - 1 : j + 1]
        if block.sum() == 1:
            (a, b) = np.argwhere(block)[0]
            found[CENTRES[i] - PIXEL / 2, CENTRES[j] - PIXEL / 2] = (2 * a - 1, 2 * b - 1)
    return found


@ALL
def test_every_convex_corner_of_the_peg_has_a_sphere_that_touches_both_faces_and_the_tip(shape):
    vertices = convex_vertices(eroded(hole_raster(shape), 2))
    radius = digits.CORNER_RADIUS
    expected = sorted((x + sx * radius, y + sy * radius) for (x, y), (sx, sy) in vertices.items())
    corners = parts(shape).peg_corners
    np.testing.assert_allclose(sorted(map(tuple, corners[:, :2])), expected, atol=1e-9)
    np.testing.assert_allclose(corners[:, 2], radius)


def disc(boxes, centre, height):
    """bool of 32 points on the circle around a sphere, inside the solid or on its surface."""
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    points = centre[:2] + digits.CORNER_RADIUS * np.stack([np.cos(angle), np.sin(angle)], -1)
    points = np.column_stack([points, np.full(32, height)])
    distance = np.abs(points[:, None] - boxes[None, :, :3]) - boxes[None, :, 3:]
    return (distance.max(axis=2) < 1e-9).any(axis=1)


@ALL
def test_contact_spheres_lie_in_their_solids(shape):
    solid = parts(shape)
    for centre in solid.peg_corners:
        assert disc(solid.peg_boxes, centre, centre[2]).all()
    for centre in solid.socket_rims:
        assert disc(solid.socket_boxes, centre, centre[2]).all()


@ALL
def test_rim_spheres_touch_the_mouth_and_every_corner_where_the_socket_is_convex(shape):
    solid, radius = parts(shape), digits.CORNER_RADIUS
    np.testing.assert_allclose(solid.socket_rims[:, 2], -radius)
    hole = parts(shape, clearance=0.0).peg_boxes
    for rim in solid.socket_rims:
        beside = np.abs(rim[:2] - hole[:, :2]) - hole[:, 3:5]
        np.testing.assert_allclose(beside.max(axis=1).min(), radius, atol=1e-9)
    rims = {tuple(np.round(rim[:2], 6)) for rim in solid.socket_rims}
    for (x, y), (sx, sy) in convex_vertices(~hole_raster(shape)).items():
        assert tuple(np.round([x + sx * radius, y + sy * radius], 6)) in rims
