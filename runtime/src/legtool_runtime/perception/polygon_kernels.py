"""Convex polygons in the floor image: arrays (CORNERS, 2) [pixels] whose first n rows are counter-clockwise corners."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

Doubles = NDArray[np.float64]

#: Corners that a polygon can have; a cut adds one at most.
CORNERS = 64
_HULL_CORNERS = 40


@kernel
def insert(points: Doubles, n: int, x: float, y: float) -> int:
    """Insert into the first n of ``points`` (m, 2), sorted by x, then y, mostly near the end; their new number."""
    k = n
    while k > 0 and (points[k - 1, 0] > x or (points[k - 1, 0] == x and points[k - 1, 1] > y)):
        points[k, 0], points[k, 1] = points[k - 1, 0], points[k - 1, 1]
        k -= 1
    points[k, 0], points[k, 1] = x, y
    return n + 1


@kernel
def hull(points: Doubles, n: int, polygon: Doubles) -> int:
    """Convex hull of the first n ``points`` (m, 2), sorted by x, then y, by Andrew's form of Graham's scan.

    Fills ``polygon`` (CORNERS, 2) and returns its number of corners, 0 for none.
    """
    corners = np.empty((2 * n + 1, 2))
    h = 0
    for k in range(n):
        while h >= 2 and _turn(corners, h, points[k, 0], points[k, 1]) <= 1e-9:
            h -= 1
        corners[h, 0], corners[h, 1] = points[k, 0], points[k, 1]
        h += 1
    lower = h + 1
    for k in range(n - 2, -1, -1):
        while h >= lower and _turn(corners, h, points[k, 0], points[k, 1]) <= 1e-9:
            h -= 1
        corners[h, 0], corners[h, 1] = points[k, 0], points[k, 1]
        h += 1
    h -= 1  # the first corner again
    kept = min(h, _HULL_CORNERS)
    for k in range(kept):  # leaving out corners keeps a hull convex and inside
        polygon[k, 0], polygon[k, 1] = corners[k * h // kept, 0], corners[k * h // kept, 1]
    return kept if kept >= 3 else 0


@kernel
def _turn(corners: Doubles, h: int, x: float, y: float) -> float:
    """Above 0 if the way over the last two corners to a point turns left."""
    ax, ay = corners[h - 2, 0], corners[h - 2, 1]
    return (corners[h - 1, 0] - ax) * (y - ay) - (corners[h - 1, 1] - ay) * (x - ax)


@kernel
def span(polygon: Doubles, n: int, x: float) -> tuple[float, float]:
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
def keep_inside(polygon: Doubles, n: int, points: Doubles, count: int) -> int:
    """Move the points (count, 2) that lie in a polygon to the front; their number."""
    left = 0
    for k in range(count):
        inside = n >= 3
        for c in range(n):
            d = c + 1 if c + 1 < n else 0
            ex, ey = polygon[d, 0] - polygon[c, 0], polygon[d, 1] - polygon[c, 1]
            inside &= ex * (points[k, 1] - polygon[c, 1]) - ey * (points[k, 0] - polygon[c, 0]) >= 0
        if inside:
            points[left, 0], points[left, 1] = points[k, 0], points[k, 1]
            left += 1
    return left


@kernel
def clip(polygon: Doubles, n: int, x: float, y: float, offset: float, out: Doubles) -> int:
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
def area(polygon: Doubles, n: Any) -> float:
    """Area of a counter-clockwise polygon."""
    total = 0.0
    for k in range(n):
        j = k + 1 if k + 1 < n else 0
        total += polygon[k, 0] * polygon[j, 1] - polygon[j, 0] * polygon[k, 1]
    return 0.5 * total
