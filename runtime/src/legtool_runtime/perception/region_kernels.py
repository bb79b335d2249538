"""Inner loops of the regions: convex hulls, what of them hangs over an edge, and cutting that off.

The floor image is a central projection, so a convex polygon in a plane is a convex polygon in the image: hulls are made
and cut in pixels (ix, iy) and carried back to the plane at the end.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.perception.superpixel_kernels import ASSUMED, EMPTY

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]
Ints = NDArray[np.int32]

#: Corners that a region can have; a cut adds one at most.
CORNERS = 64
_HULL_CORNERS = 40
#: Directions in which a cut is tried, and cuts per region.
_DIRECTIONS, _CUTS = 16, 20
#: An empty pixel is held by ground this many pixels away on both sides.
_HELD = 2
_SUPPORTED, _UNSEEN, _FOREIGN = range(3)


@kernel
def build(
    channels: Floats,
    state: NDArray[np.uint8],
    start: Ints,
    order: Ints,
    points: Doubles,
    axes: Doubles,
    assumed: NDArray[np.bool_],
    tolerance: float,
    focal_length: float,
    trim: bool,
    corners: Doubles,
    sizes: Ints,
    areas: Doubles,
    overhang: Doubles,
) -> None:
    """Regions of all superpixels.

    Args:
        points: (k, 3) a point of each plane, levelled frame [m]; axes: (k, 3, 3) rows x, y and normal of each plane.
        corners: (k, CORNERS, 2) filled with the corners in the plane's x and y [m]; sizes: (k,) with their number, 0
            where there is no region; areas: (k,) with their areas [m²].
        overhang: (k, 2) filled with the area over edges before and after cutting [m²].
    """
    side = state.shape[0]
    middle = 0.5 * side - 0.5
    polygon, spare = np.empty((CORNERS, 2)), np.empty((CORNERS, 2))
    cuts = np.empty((_CUTS, 3))
    bad = np.empty((side * side, 2))
    for c in range(points.shape[0]):
        point, normal = points[c], axes[c, 2]
        sizes[c], areas[c] = 0, 0.0
        begin, end = start[c], start[c + 1]
        n = _outline(channels, order, begin, end, point, normal, tolerance, focal_length, side, cuts, 0, polygon)
        if n < 3:
            continue
        found = _hanging(channels, state, polygon, n, point, normal, assumed[c], 2.0 * tolerance, bad)
        pixel = _pixel_area(polygon, n, point, normal, focal_length, middle)
        overhang[c, 0] = found * pixel
        for cut in range(_CUTS if trim else 0):
            if found == 0 or n < 3:
                break
            _place_cut(polygon, spare, n, bad, found, cuts[cut])
            # The new edge is again a hull of points: it ends where ground was seen, not half a pixel further.
            n = _outline(
                channels, order, begin, end, point, normal, tolerance, focal_length, side, cuts, cut + 1, polygon
            )
            found = _still_inside(polygon, n, bad, found)
        overhang[c, 1] = found * pixel
        if n >= 3:
            sizes[c] = _to_plane(polygon, n, point, axes[c], focal_length, middle, corners[c])
            areas[c] = _area(corners[c], sizes[c])


@kernel
def _outline(
    channels: Floats,
    order: Ints,
    begin: Any,
    end: Any,
    point: Doubles,
    normal: Doubles,
    tolerance: float,
    focal_length: float,
    side: int,
    cuts: Doubles,
    cut_count: int,
    polygon: Doubles,
) -> int:
    """Convex hull of the points within ``tolerance`` of the plane, projected onto it: number of corners, 0 for none.

    Points beyond a line of ``cuts`` (m, 3), a·ix + b·iy > c, are left out. Candidates are the outermost points of each
    row of pixels; the hull is Andrew's form of Graham's scan.
    """
    middle = 0.5 * side - 0.5
    if begin >= end:
        return 0
    low, high = order[begin] // side - 2, order[end - 1] // side + 2
    rows = high - low + 1
    least, greatest = np.full((rows, 2), np.inf), np.full((rows, 2), -np.inf)
    for m in range(begin, end):
        i = order[m]
        x, y, z = np.float64(channels[0, i]), np.float64(channels[1, i]), np.float64(channels[2, i])
        away = (x - point[0]) * normal[0] + (y - point[1]) * normal[1] + (z - point[2]) * normal[2]
        z -= away * normal[2]
        if abs(away) > tolerance or z > -1e-6:
            continue
        ix = focal_length * (x - away * normal[0]) / -z + middle
        iy = focal_length * (y - away * normal[1]) / -z + middle
        beyond = False
        for k in range(cut_count):
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
            n = _insert(candidates, n, least[row, 0], least[row, 1])
            n = _insert(candidates, n, greatest[row, 0], greatest[row, 1])
    hull = np.empty((2 * n + 1, 2))
    h = 0
    for k in range(n):
        while h >= 2 and _turn(hull, h, candidates[k, 0], candidates[k, 1]) <= 1e-9:
            h -= 1
        hull[h, 0], hull[h, 1] = candidates[k, 0], candidates[k, 1]
        h += 1
    lower = h + 1
    for k in range(n - 2, -1, -1):
        while h >= lower and _turn(hull, h, candidates[k, 0], candidates[k, 1]) <= 1e-9:
            h -= 1
        hull[h, 0], hull[h, 1] = candidates[k, 0], candidates[k, 1]
        h += 1
    h -= 1  # the first corner again
    kept = min(h, _HULL_CORNERS)
    for k in range(kept):  # leaving out corners keeps a hull convex and inside
        polygon[k, 0], polygon[k, 1] = hull[k * h // kept, 0], hull[k * h // kept, 1]
    return kept if kept >= 3 else 0


@kernel
def _insert(points: Doubles, n: int, x: float, y: float) -> int:
    """Insert into points sorted by x, then y; almost always at or near the end."""
    k = n
    while k > 0 and (points[k - 1, 0] > x or (points[k - 1, 0] == x and points[k - 1, 1] > y)):
        points[k, 0], points[k, 1] = points[k - 1, 0], points[k - 1, 1]
        k -= 1
    points[k, 0], points[k, 1] = x, y
    return n + 1


@kernel
def _turn(hull: Doubles, h: int, x: float, y: float) -> float:
    """Above 0 if the way over the hull's last two corners to a point turns left."""
    ax, ay = hull[h - 2, 0], hull[h - 2, 1]
    return (hull[h - 1, 0] - ax) * (y - ay) - (hull[h - 1, 1] - ay) * (x - ax)


@kernel
def _hanging(
    channels: Floats,
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
    side = state.shape[0]
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
        left, right = _span(polygon, n, float(ix))
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
def _span(polygon: Doubles, n: int, x: float) -> tuple[float, float]:
    """Where the line ix = x enters and leaves a convex polygon."""
    left, right = np.inf, -np.inf
    for k in range(n):
        m = k + 1 if k + 1 < n else 0
        ax, bx = polygon[k, 0], polygon[m, 0]
        if (ax <= x <= bx) or (bx <= x <= ax):
            ay, by = polygon[k, 1], polygon[m, 1]
            if ax == bx:
                left, right = min(left, ay, by), max(right, ay, by)
            else:
                y = ay + (by - ay) * (x - ax) / (bx - ax)
                left, right = min(left, y), max(right, y)
    return left, right


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
        area = _area(spare, _clip(polygon, n, x, y, offset, spare))
        if area > most:
            most = area
            cut[0], cut[1], cut[2] = x, y, offset


@kernel
def _still_inside(polygon: Doubles, n: int, bad: Doubles, found: int) -> int:
    """Keep the pixels of ``bad`` that lie in a polygon; their number."""
    left = 0
    for k in range(found):
        inside = n >= 3
        for c in range(n):
            d = c + 1 if c + 1 < n else 0
            ex, ey = polygon[d, 0] - polygon[c, 0], polygon[d, 1] - polygon[c, 1]
            inside &= ex * (bad[k, 1] - polygon[c, 1]) - ey * (bad[k, 0] - polygon[c, 0]) >= 0
        if inside:
            bad[left, 0], bad[left, 1] = bad[k, 0], bad[k, 1]
            left += 1
    return left


@kernel
def _clip(polygon: Doubles, n: int, x: float, y: float, offset: float, out: Doubles) -> int:
    """The part of a convex polygon where x·ix + y·iy ≤ offset; its number of corners."""
    m = 0
    for k in range(n):
        j = k + 1 if k + 1 < n else 0
        a = x * polygon[k, 0] + y * polygon[k, 1] - offset
        b = x * polygon[j, 0] + y * polygon[j, 1] - offset
        if a <= 0 and m < CORNERS:
            out[m, 0], out[m, 1] = polygon[k, 0], polygon[k, 1]
            m += 1
        if (a < 0 < b or b < 0 < a) and m < CORNERS:
            s = a / (a - b)
            out[m, 0] = polygon[k, 0] + s * (polygon[j, 0] - polygon[k, 0])
            out[m, 1] = polygon[k, 1] + s * (polygon[j, 1] - polygon[k, 1])
            m += 1
    return m


@kernel
def _area(polygon: Doubles, n: Any) -> float:
    """Area of a counter-clockwise polygon."""
    total = 0.0
    for k in range(n):
        j = k + 1 if k + 1 < n else 0
        total += polygon[k, 0] * polygon[j, 1] - polygon[j, 0] * polygon[k, 1]
    return 0.5 * total


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
