"""The egocan's inner loops: projecting points onto the can, moving what it holds, reading it as images.

The can's cells are numbered cylinder first, then floor, then ceiling. ``shape`` is width and height of the cylinder and
side of a cap; ``scale`` is cells per radian, cells per unit of z/ρ, cells per unit of x/z, and z/ρ at the cylinder's
rim.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

Floats = NDArray[np.float32]
Labels = NDArray[np.uint8]

_HALF_PI, _PI = np.float32(0.5 * np.pi), np.float32(np.pi)
#: Minimax polynomial of atan(t)/t in t² on [0, 1], error 1e-5 rad: a thousandth of a cell.
_A0, _A1, _A2, _A3, _A4, _A5 = np.array(
    [0.99997726, -0.33262347, 0.19354346, -0.11643287, 0.05265332, -0.01172120], dtype=np.float32
)
_TINY = np.float32(1e-9)
#: Two returns closer than this are the same surface, at 0 m from the camera; it grows with the square of distance [m].
SURFACE_MARGIN = np.float32(0.02)


class Can(NamedTuple):
    """What the can holds.

    Attributes:
        near: (n,) the distance that decides which return is nearer [m]: range ρ on the cylinder, height |z| on a cap;
            inf where the cell is empty.
        cells: (n, 6) the exact point [m] and its normal, levelled frame.
        labels: (n,) index into LABELS.
    """

    near: Floats
    cells: Floats
    labels: Labels


class Transform(NamedTuple):
    """From one frame to another.

    Attributes:
        rotation: (3, 3).
        translation: (3,) [m].
    """

    rotation: Floats
    translation: Floats


class EgocanScratch(NamedTuple):
    """Room for :func:`move`.

    Attributes:
        points: (3, n) the points that the can holds at their new place [m].
        cell: (n,) the cell that each falls into, -1 once it is placed.
        distance: (n,) of each in that cell [m].
        source: (n,) the cell that each comes from.
    """

    points: Floats
    cell: NDArray[np.int32]
    distance: Floats
    source: NDArray[np.int32]


@kernel
def project(points: Floats, count: int, shape: Any, scale: Floats, cell: NDArray[np.int32], distance: Floats) -> None:
    """The cell that each point falls into and its distance there (equations 1, 2, 4); distance NaN for NaN.

    Written without branches and with clamps on floats, so that the compiler takes eight points at a time.

    Args:
        points: (3, n) of which the first ``count`` are looked at, levelled frame [m].
    """
    width, _, side = np.int32(shape[0]), np.int32(shape[1]), np.int32(shape[2])
    below = np.int32(shape[0] * shape[1])
    above = np.int32(below + side * side)
    zero, half = np.float32(0.0), np.float32(0.5)
    middle_u, middle_v, middle = half * np.float32(shape[0]), half * np.float32(shape[1]), half * np.float32(shape[2])
    last_u, last_v, last = np.float32(shape[0] - 1), np.float32(shape[1] - 1), np.float32(shape[2] - 1)
    per_radian, per_slope, per_tangent, rim = scale[0], scale[1], scale[2], scale[3]
    for i in range(count):
        x, y, z = points[0, i], points[1, i], points[2, i]
        absolute_x, absolute_y, absolute_z = abs(x), abs(y), abs(z)
        rho = np.sqrt(x * x + y * y)
        # Cylinder: θ is 0 ahead and grows to the right, as u does.
        low = absolute_x if absolute_x < absolute_y else absolute_y
        high = absolute_y if absolute_x < absolute_y else absolute_x
        t = low / (high + _TINY)
        t2 = t * t
        angle = t * (_A0 + t2 * (_A1 + t2 * (_A2 + t2 * (_A3 + t2 * (_A4 + t2 * _A5)))))
        angle = _HALF_PI - angle if absolute_y > absolute_x else angle
        angle = _PI - angle if x < zero else angle
        angle = -angle if y > zero else angle
        u = angle * per_radian + middle_u
        u = last_u if u > last_u else u
        v = middle_v - z * per_slope / (rho + _TINY)
        v = last_v if v > last_v else v
        # Caps: central projection onto the plane below or above.
        inverse = per_tangent / (absolute_z + _TINY)
        ix, iy = x * inverse + middle, y * inverse + middle
        ix = zero if ix < zero else ix
        ix = last if ix > last else ix
        iy = zero if iy < zero else iy
        iy = last if iy > last else iy
        cap = (above if z > zero else below) + np.int32(ix) * side + np.int32(iy)
        on_cylinder = absolute_z <= rho * rim
        cell[i] = np.int32(v) * width + np.int32(u) if on_cylinder else cap
        distance[i] = rho if on_cylinder else absolute_z


@kernel
def move(motion: Transform, shape: Any, scale: Floats, can: Can, moved: Can, scratch: EgocanScratch) -> None:
    """Carry every point of ``can`` to the can's new place (equation 3), ``moved``; the nearest return wins a cell.

    ``motion`` leads from the old levelled frame to the new one. Points move against the grid of cells, and two of one
    surface often meet in one cell while the next stays empty: taken alone the rule would thin a floor to a third within
    a metre. On the caps the loser of two points of one surface therefore lodges in the empty cell that it lies closest
    to.
    """
    r, t = motion
    near, cells, labels = can
    moved_near, moved_cells, moved_labels = moved
    points, cell, distance, source = scratch
    empty = np.float32(np.inf)
    count = 0
    for i in range(near.size):  # without a branch, which would be guessed wrong at every edge
        source[count] = i
        count += near[i] < empty
    for i in range(count):
        x, y, z = cells[source[i], 0], cells[source[i], 1], cells[source[i], 2]
        points[0, i] = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + t[0]
        points[1, i] = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + t[1]
        points[2, i] = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + t[2]
    project(points, count, shape, scale, cell, distance)
    moved_near[:] = empty
    for i in range(count):
        if distance[i] < moved_near[cell[i]]:
            moved_near[cell[i]] = distance[i]
    for i in range(count):
        to = cell[i]
        # The first of equals takes the cell: its sign marks that it is taken.
        if distance[i] == moved_near[to]:
            moved_near[to] = -distance[i]
            _carry(r, points, i, cells, source[i], moved_cells, to)
            moved_labels[to] = labels[source[i]]
            cell[i] = -1
    first_cap = np.int32(shape[0] * shape[1])
    for i in range(count):
        if cell[i] >= first_cap and distance[i] + moved_near[cell[i]] < SURFACE_MARGIN:
            to = _lodging(points, i, cell[i], first_cap, shape[2], scale[2], moved_near)
            if to >= 0:
                moved_near[to] = -distance[i]
                _carry(r, points, i, cells, source[i], moved_cells, to)
                moved_labels[to] = labels[source[i]]
    for i in range(moved_near.size):
        moved_near[i] = abs(moved_near[i])


@kernel
def _carry(r: Floats, points: Floats, i: int, cells: Floats, source: Any, moved_cells: Floats, to: Any) -> None:
    x, y, z = cells[source, 3], cells[source, 4], cells[source, 5]
    moved_cells[to, 0], moved_cells[to, 1], moved_cells[to, 2] = points[0, i], points[1, i], points[2, i]
    moved_cells[to, 3] = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z
    moved_cells[to, 4] = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z
    moved_cells[to, 5] = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z


@kernel
def _lodging(points: Floats, i: int, cell: Any, first_cap: Any, side: int, per_tangent: Any, near: Floats) -> Any:
    """The empty neighbour that a point lies closest to, -1 if there is none."""
    inverse = per_tangent / abs(points[2, i])
    half, middle = np.float32(0.5), np.float32(0.5) * np.float32(side)
    ix, iy = ((cell - first_cap) % (side * side)) // side, (cell - first_cap) % side
    x = points[0, i] * inverse + middle - np.float32(ix) - half
    y = points[1, i] * inverse + middle - np.float32(iy) - half
    step_x, step_y = (1 if x > 0 else -1), (1 if y > 0 else -1)
    inside_x, inside_y = 0 <= ix + step_x < side, 0 <= iy + step_y < side
    along_x, along_y = cell + step_x * side, cell + step_y
    x_first = abs(x) > abs(y)
    for attempt in range(2):
        if x_first == (attempt == 0):
            if inside_x and near[along_x] == np.float32(np.inf):
                return along_x
        elif inside_y and near[along_y] == np.float32(np.inf):
            return along_y
    if inside_x and inside_y and near[along_x + step_y] == np.float32(np.inf):
        return along_x + step_y
    return -1


@kernel
def extract(
    can: Can,
    begin: int,
    points: Floats,
    normals: Floats,
    image_labels: Labels,
) -> None:
    """Copy the cells from ``begin`` on into points (m, 3), normals (m, 3) and labels (m,); NaN where there is none."""
    near, cells, labels = can
    nan = np.float32(np.nan)
    for i in range(points.shape[0]):
        full = near[begin + i] < np.float32(np.inf)
        for axis in range(3):
            points[i, axis] = cells[begin + i, axis] if full else nan
            normals[i, axis] = cells[begin + i, 3 + axis] if full else nan
        image_labels[i] = labels[begin + i] if full else np.uint8(0)
