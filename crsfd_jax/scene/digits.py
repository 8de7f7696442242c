"""Shapes as pure geometry: a grid of cells becomes peg and socket solids.

All coordinates are in the socket frame: x and y in the plane of the mouth, z up, origin in the
middle of the mouth for the socket and of the tip for the peg. The hole is the union of the cells,
the peg is the hole eroded by half the clearance on every side.

Contacts are spheres against boxes, which every engine computes exactly and quickly: spheres in the
peg's convex corners against the socket's boxes, and spheres along the rim of the mouth against the
peg's boxes. Between them they stop a vertex of either part from entering a face of the other.
"""

from dataclasses import dataclass

import numpy as np

from crsfd_jax.options import shapes

HOLE_DEPTH = 0.030
"""m, mouth to floor."""
PEG_LENGTH = 0.060
"""m, tip to top of the peg."""
GRIP_LENGTH = 0.015
"""m, of the peg's top between the fingers, so that hand and socket stay apart."""
BLOCK_HALF_WIDTH = 0.07
"""m, half side of the socket block: the peg stays on it wherever the setpoint may go."""
BLOCK_HEIGHT = 0.045
"""m, mouth to table."""
CORNER_RADIUS = 0.001
"""m, radius of the contact spheres, a small chamfer."""
_RIM_INSET = 0.003
"""m, distance of a rim sphere from the end of its edge."""


@dataclass(frozen=True)
class Solids:
    """Contact primitives of one peg and its socket, m."""

    peg_boxes: np.ndarray
    """[K, 6] centre and half sizes, in the peg frame."""
    peg_corners: np.ndarray
    """[P, 3] sphere centres in the peg frame."""
    socket_boxes: np.ndarray
    """[B, 6] centre and half sizes, in the socket frame."""
    socket_rims: np.ndarray
    """[M, 3] sphere centres in the socket frame."""


def solids(shape: str, footprint: float, clearance: float) -> Solids:
    """Peg and socket of a shape.

    Args:
      shape: one of those that `shapes.read` gives.
      footprint: longer side of the grid, m.
      clearance: width of the hole minus width of the peg, m; negative for a peg too large.
    """
    cells = _cells(shapes.grid(shape))
    pitch = footprint / max(cells.shape)
    outside = np.pad(~cells, 1, constant_values=True)
    edges = [(np.arange(n + 1) - n / 2) * pitch for n in cells.shape]
    outer = [np.concatenate([[-BLOCK_HALF_WIDTH], e, [BLOCK_HALF_WIDTH]]) for e in edges]
    half_gap = clearance / 2
    peg = [_prism(*_extent(r, edges, -half_gap), 0.0, PEG_LENGTH) for r in _cover(cells)]
    socket = [_prism(*_extent(r, outer), -HOLE_DEPTH, 0.0) for r in _cover(outside)]
    block = (-BLOCK_HALF_WIDTH, BLOCK_HALF_WIDTH)
    socket.append(_prism(block, block, -BLOCK_HEIGHT, -HOLE_DEPTH))
    return Solids(
        peg_boxes=np.array(peg),
        peg_corners=_peg_corners(cells, edges, half_gap),
        socket_boxes=np.array(socket),
        socket_rims=_socket_rims(cells, edges),
    )


def _cells(grid):
    """[nx, ny] bool, indexed by x to the right and y upwards."""
    rows = np.array([[c == "#" for c in row] for row in grid])
    return rows[::-1].T


def _rectangles(cells):
    """All maximal rectangles (x0, x1, y0, y1) of filled cells, upper bounds exclusive."""
    nx, ny = cells.shape
    full = [
        (x0, x1, y0, y1)
        for x0 in range(nx)
        for x1 in range(x0 + 1, nx + 1)
        for y0 in range(ny)
        for y1 in range(y0 + 1, ny + 1)
        if cells[x0:x1, y0:y1].all()
    ]

    def inside(a, b):
        return a != b and b[0] <= a[0] and a[1] <= b[1] and b[2] <= a[2] and a[3] <= b[3]

    return [r for r in full if not any(inside(r, other) for other in full)]


def _cover(cells):
    """Few maximal rectangles that cover every filled cell and every pair of neighbours.

    They overlap rather than abut, so a sphere that slides over a face meets no seam, and eroding
    each of them erodes their union.
    """
    nx, ny = cells.shape
    blocks = [
        (x, x + dx, y, y + dy)
        for dx, dy in ((1, 1), (2, 1), (1, 2), (2, 2))
        for x in range(nx - dx + 1)
        for y in range(ny - dy + 1)
        if cells[x : x + dx, y : y + dy].all()
    ]
    todo, chosen, candidates = set(blocks), [], _rectangles(cells)

    def gain(r):
        return {b for b in todo if r[0] <= b[0] and b[1] <= r[1] and r[2] <= b[2] and b[3] <= r[3]}

    while todo:
        best = max(candidates, key=lambda r: len(gain(r)))
        todo -= gain(best)
        chosen.append(best)
    return chosen


def _extent(rectangle, edges, grow=0.0):
    x0, x1, y0, y1 = rectangle
    x, y = edges
    return (x[x0] - grow, x[x1] + grow), (y[y0] - grow, y[y1] + grow)


def _prism(x, y, z0, z1):
    low, high = np.array([x[0], y[0], z0]), np.array([x[1], y[1], z1])
    return np.concatenate([(low + high) / 2, (high - low) / 2])


def _corners(cells):
    """Vertices of the outline as {(i, j): (sx, sy, convex)}.

    The cell at the quadrant (sx, sy) of vertex (i, j) is the only filled one (convex) or the only
    empty one (reentrant).
    """
    padded, corners = np.pad(cells, 1), {}
    quadrants = [(sx, sy) for sx in (-1, 1) for sy in (-1, 1)]
    for i in range(cells.shape[0] + 1):
        for j in range(cells.shape[1] + 1):
            around = [padded[i + (sx + 1) // 2, j + (sy + 1) // 2] for sx, sy in quadrants]
            if sum(around) in (1, 3):
                convex = sum(around) == 1
                corners[i, j] = (*quadrants[around.index(convex)], convex)
    return corners


def _peg_corners(cells, edges, half_gap):
    inset = half_gap + CORNER_RADIUS
    return np.array(
        [
            (edges[0][i] + sx * inset, edges[1][j] + sy * inset, CORNER_RADIUS)
            for (i, j), (sx, sy, convex) in _corners(cells).items()
            if convex
        ]
    )


def _socket_rims(cells, edges):
    """Spheres that touch the mouth plane and the walls from inside the socket's solid.

    A reentrant vertex gets one, which touches both its walls; every convex vertex gets one along
    each of its two walls, and a wall of one cell between two of them shares one in its middle.
    """
    r, corners, rims = CORNER_RADIUS, _corners(cells), set()
    pitch = edges[0][1] - edges[0][0]
    for (i, j), (sx, sy, convex) in corners.items():
        x, y = edges[0][i], edges[1][j]
        if not convex:
            rims.add((x + sx * r, y + sy * r, -r))
            continue
        alone_x = not corners.get((i + sx, j), (0, 0, False))[2]
        alone_y = not corners.get((i, j + sy), (0, 0, False))[2]
        # A wall of one cell may end at a reentrant vertex, past which it must not reach.
        longest = min(_RIM_INSET, pitch - r)
        along_x = longest if alone_x else pitch / 2
        along_y = longest if alone_y else pitch / 2
        rims.add((x - sx * r, y + sy * along_y, -r))
        rims.add((x + sx * along_x, y - sy * r, -r))
    return np.unique(np.round(sorted(rims), 9), axis=0)
