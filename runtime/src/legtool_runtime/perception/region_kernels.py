"""Inner loops of the regions: convex hulls, what of them hangs over an edge, and cutting that off.

The floor image is a central projection, so a convex polygon in a plane is a convex polygon in the image: hulls are made
and cut in pixels (ix, iy) and carried back to the plane at the end.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.perception.polygon_kernels import CORNERS, Doubles, area, clip, hull, insert, keep_inside, span
from legtool_runtime.perception.superpixel_kernels import ASSUMED, EMPTY, Floor, Ints

#: Directions in which a cut is tried, and cuts per region.
_DIRECTIONS, _CUTS = 16, 20
#: An empty pixel is held by ground this many pixels away on both sides.
_HELD = 2
_SUPPORTED, _UNSEEN, _FOREIGN = range(3)


class Planes(NamedTuple):
    """The planes of k superpixels.

    Attributes:
        points: (k, 3) a point of each, levelled frame [m].
        axes: (k, 3, 3) rows x, y and normal of each.
        assumed: (k,) whether the ground there is only assumed.
    """

    points: Doubles
    axes: Doubles
    assumed: NDArray[np.bool_]


class Outlines(NamedTuple):
    """What :func:`build` fills.

    Attributes:
        corners: (k, CORNERS, 2) corners in the plane's x and y [m].
        sizes: (k,) their number, 0 where there is no region.
        areas: (k,) [m²].
        overhang: (k, 2) area over edges before and after cutting [m²].
    """

    corners: Doubles
    sizes: Ints
    areas: Doubles
    overhang: Doubles


@kernel
def build(
    floor: Floor,
    state: NDArray[np.uint8],
    start: Ints,
    order: Ints,
    planes: Planes,
    tolerance: float,
    trim: bool,
    out: Outlines,
) -> None:
    """Regions of all superpixels.

    Args:
        floor: the image that they are parts of.
        state: (side, side) EMPTY, HEALTHY, ASSUMED or REMOVED.
        start, order: members of superpixel c are the flat pixels ``order[start[c]:start[c + 1]]``.
        planes: of the superpixels.
        tolerance: points farther from the plane do not shape the region [m].
        trim: whether what hangs over edges is cut off.
        out: is filled.
    """
    side, focal_length = floor.side, floor.focal_length
    points, axes, assumed = planes
    corners, sizes, areas, overhang = out
    middle = 0.5 * side - 0.5
    polygon, spare = np.empty((CORNERS, 2)), np.empty((CORNERS, 2))
    cuts = np.empty((_CUTS, 3))
    bad = np.empty((side * side, 2))
    for c in range(points.shape[0]):
        point, normal = points[c], axes[c, 2]
        sizes[c], areas[c] = 0, 0.0
        members = order[start[c] : start[c + 1]]
        n = _outline(floor, members, point, normal, tolerance, cuts[:0], polygon)
        if n < 3:
            continue
        found = _hanging(floor, state, polygon, n, point, normal, assumed[c], 2.0 * tolerance, bad)
        pixel = _pixel_area(polygon, n, point, normal, focal_length, middle)
        overhang[c, 0] = found * pixel
        for cut in range(_CUTS if trim else 0):
            if found == 0 or n < 3:
                break
            _place_cut(polygon, spare, n, bad, found, cuts[cut])
            # The new edge is again a hull of points: it ends where ground was seen, not half a pixel further.
            n = _outline(floor, members, point, normal, tolerance, cuts[: cut + 1], polygon)
            found = keep_inside(polygon, n, bad, found)
        overhang[c, 1] = found * pixel
        if n >= 3:
            sizes[c] = _to_plane(polygon, n, point, axes[c], focal_length, middle, corners[c])
            areas[c] = area(corners[c], sizes[c])


@kernel
def _outline(
    floor: Floor,
    members: Ints,
    point: Doubles,
    normal: Doubles,
    tolerance: float,
    cuts: Doubles,
    polygon: Doubles,
) -> int:
    """Convex hull of the points within ``tolerance`` of the plane, projected onto it: number of corners, 0 for none.

    ``members`` (m,) are flat pixels in rising order. Points beyond a line of ``cuts`` (l, 3), a·ix + b·iy > c, are left
    out. Candidates are the outermost points of each row of pixels.
    """
    channels, side, focal_length = floor
    middle = 0.5 * side - 0.5
    if members.size == 0:
        return 0
    low, high = members[0] // side - 2, members[-1] // side + 2
    rows = high - low + 1
    least, greatest = np.full((rows, 2), np.inf), np.full((rows, 2), -np.inf)
    # Read once: the compiler does not know that what is written below is no part of them.
    px, py, pz, nx, ny, nz = point[0], point[1], point[2], normal[0], normal[1], normal[2]
    for m in range(members.size):
        i = members[m]
        x, y, z = np.float64(channels[0, i]), np.float64(channels[1, i]), np.float64(channels[2, i])
        away = (x - px) * nx + (y - py) * ny + (z - pz) * nz
        z -= away * nz
        if abs(away) > tolerance or z > -1e-6:
            continue
        ix = focal_length * (x - away * nx) / -z + middle
        iy = focal_length * (y - away * ny) / -z + middle
        beyond = False
        for k in range(cuts.shape[0]):
            beyond |= cuts[k, 0] * ix + cuts[k, 1] * iy > cuts[k, 2]
        if beyond:
            continue
        row = min(max(int(np.floor(ix + 0.5)) - low, 0), rows - 1)
        if iy < least[row, 1]:
            least[row, 0], least[row, 1] = ix, iy
        if iy > greatest[row, 1]:
            greatest[row, 0], greatest[row, 1] = ix, iy
    candidates = np.empty((2 * rows, 2))
    n = 0
    for row in range(rows):
        if least[row, 1] < np.inf:
            n = insert(candidates, n, least[row, 0], least[row, 1])
            n = insert(candidates, n, greatest[row, 0], greatest[row, 1])
    return hull(candidates, n, polygon)


@kernel
def _hanging(
    floor: Floor,
    state: NDArray[np.uint8],
    polygon: Doubles,
    n: int,
    point: Doubles,
    normal: Doubles,
    assumed: Any,
    tolerance: float,
    bad: Doubles,
) -> int:
    """List the pixels of a polygon that its plane does not hold in ``bad`` (m, 2); their number.

    A pixel is held where a healthy point lies in the plane. One that shows something else is not, unless it is a speck
    among such points; an empty one is not unless it lies between such points, which are two pixels away at most.
    """
    channels, side = floor.channels, floor.side
    low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
    for k in range(n):
        low_x, high_x = min(low_x, polygon[k, 0]), max(high_x, polygon[k, 0])
        low_y, high_y = min(low_y, polygon[k, 1]), max(high_y, polygon[k, 1])
    x0, x1 = max(0, int(low_x) - _HELD), min(side, int(high_x) + 2 + _HELD)
    y0, y1 = max(0, int(low_y) - _HELD), min(side, int(high_y) + 2 + _HELD)
    kind = np.float32(1.0) if assumed else np.float32(0.0)
    px, py, pz = np.float32(point[0]), np.float32(point[1]), np.float32(point[2])
    nx, ny, nz = np.float32(normal[0]), np.float32(normal[1]), np.float32(normal[2])
    ground = np.empty((x1 - x0, y1 - y0), np.uint8)
    for ix in range(x0, x1):
        for iy in range(y0, y1):
            i = ix * side + iy
            away = abs((channels[0, i] - px) * nx + (channels[1, i] - py) * ny + (channels[2, i] - pz) * nz)
            other = _UNSEEN if state[ix, iy] == EMPTY or state[ix, iy] == ASSUMED else _FOREIGN
            ground[ix - x0, iy - y0] = _SUPPORTED if away < tolerance and channels[6, i] == kind else other
    found = 0
    for ix in range(max(x0, int(np.ceil(low_x))), min(x1, int(high_x) + 1)):
        left, right = span(polygon, n, float(ix))
        for iy in range(max(y0, int(np.ceil(left))), min(y1, int(np.floor(right)) + 1)):
            what = ground[ix - x0, iy - y0]
            if what == _SUPPORTED:
                continue
            jx, jy = ix - x0, iy - y0
            if what == _UNSEEN and not _between(ground, jx, jy):
                bad[found, 0], bad[found, 1] = ix, iy
                found += 1
            elif what == _FOREIGN:
                held, foreign = 0, 0
                for kx in range(max(0, jx - 1), min(x1 - x0, jx + 2)):
                    for ky in range(max(0, jy - 1), min(y1 - y0, jy + 2)):
                        held += ground[kx, ky] == _SUPPORTED
                        foreign += ground[kx, ky] == _FOREIGN
                if foreign >= held:
                    bad[found, 0], bad[found, 1] = ix, iy
                    found += 1
    return found


@kernel
def _between(ground: NDArray[np.uint8], x: int, y: int) -> bool:
    """Whether supported pixels lie close to a pixel on two opposite sides."""
    for axis in range(4):
        step_x, step_y = (1, axis - 1) if axis < 3 else (0, 1)
        sides = 0
        for sign in (-1, 1):
            for k in range(1, _HELD + 1):
                kx, ky = x + sign * k * step_x, y + sign * k * step_y
                if 0 <= kx < ground.shape[0] and 0 <= ky < ground.shape[1] and ground[kx, ky] == _SUPPORTED:
                    sides += 1
                    break
        if sides == 2:
            return True
    return False


@kernel
def _place_cut(polygon: Doubles, spare: Doubles, n: int, bad: Doubles, found: int, cut: Doubles) -> None:
    """The line a·ix + b·iy = c that cuts off the pixel of ``bad`` closest to the middle, and least of the polygon."""
    mx, my = 0.0, 0.0
    for k in range(n):
        mx, my = mx + polygon[k, 0] / n, my + polygon[k, 1] / n
    closest, q = np.inf, 0
    for k in range(found):
        distance = (bad[k, 0] - mx) ** 2 + (bad[k, 1] - my) ** 2
        if distance < closest:
            closest, q = distance, k
    most = -1.0
    for k in range(_DIRECTIONS):
        angle = 2.0 * np.pi * k / _DIRECTIONS
        x, y = np.cos(angle), np.sin(angle)
        # The whole pixel goes.
        offset = x * bad[q, 0] + y * bad[q, 1] - 0.5 * (abs(x) + abs(y))
        kept = area(spare, clip(polygon, n, x, y, offset, spare))
        if kept > most:
            most = kept
            cut[0], cut[1], cut[2] = x, y, offset


@kernel
def _pixel_area(polygon: Doubles, n: int, point: Doubles, normal: Doubles, focal_length: float, middle: float) -> float:
    """Area in the plane of a pixel amid a polygon [m²]: (z / f)² / |ray · n| for the ray (x, y, -1)."""
    x, y = 0.0, 0.0
    for k in range(n):
        x, y = x + (polygon[k, 0] - middle) / (focal_length * n), y + (polygon[k, 1] - middle) / (focal_length * n)
    incidence = x * normal[0] + y * normal[1] - normal[2]
    distance = (point[0] * normal[0] + point[1] * normal[1] + point[2] * normal[2]) / incidence
    return (distance / focal_length) ** 2 / abs(incidence)


@kernel
def _to_plane(
    polygon: Doubles, n: int, point: Doubles, axes: Doubles, focal_length: float, middle: float, corners: Doubles
) -> int:
    """Corners in the plane's own x and y; 0 where the plane is seen edge on."""
    normal = axes[2]
    plane = point[0] * normal[0] + point[1] * normal[1] + point[2] * normal[2]
    for k in range(n):
        x, y = (polygon[k, 0] - middle) / focal_length, (polygon[k, 1] - middle) / focal_length
        incidence = x * normal[0] + y * normal[1] - normal[2]
        if incidence > -0.02 or plane >= 0:
            return 0
        t = plane / incidence
        dx, dy, dz = t * x - point[0], t * y - point[1], -t - point[2]
        corners[k, 0] = dx * axes[0, 0] + dy * axes[0, 1] + dz * axes[0, 2]
        corners[k, 1] = dx * axes[1, 0] + dy * axes[1, 1] + dz * axes[1, 2]
    return n
