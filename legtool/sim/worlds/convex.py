"""Convex polygons in the plane: hulls, cuts, and what is left of one that another covers.

A polygon is an array (n, 2), corners counter-clockwise; one without area has no corners.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Corners nearer to a line than this lie on it [m]; polygons smaller than this are none [m²].
_ON_M, _NONE_M2 = 1e-9, 1e-9
_EMPTY = np.empty((0, 2))


def area(polygon: Array) -> float:
    """Area [m²]; below 0 if the corners go clockwise."""
    x, y = polygon.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) if len(polygon) else 0.0


def centroid(polygon: Array) -> Array:
    """(2,) the middle of a polygon's area."""
    a, b = polygon - polygon[0], np.roll(polygon, -1, axis=0) - polygon[0]
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    middle: Array = polygon[0] + ((a + b) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum())
    return middle


def hull(points: Array) -> Array:
    """Convex hull of points (m, 2)."""
    order = sorted(map(tuple, points.tolist()))
    chains: list[list[tuple[float, ...]]] = []
    for way in (order, order[::-1]):
        chain: list[tuple[float, ...]] = []
        for point in way:
            while len(chain) >= 2 and _turn(chain[-2], chain[-1], point) <= 0.0:
                chain.pop()
            chain.append(point)
        chains.append(chain[:-1])
    out = np.array(chains[0] + chains[1]).reshape(-1, 2)
    return out if len(out) >= 3 and area(out) > _NONE_M2 else _EMPTY


def cut(polygon: Array, normal: Array, offset: float) -> Array:
    """The part of a polygon with normal · p ≤ offset."""
    if not len(polygon):
        return polygon
    away = polygon @ normal - offset
    if (away <= _ON_M).all():
        return polygon
    if (away >= -_ON_M).all():
        return _EMPTY
    out: list[Array] = []
    for k in range(len(polygon)):
        before, here = away[k - 1], away[k]
        if (before > _ON_M and here < -_ON_M) or (before < -_ON_M and here > _ON_M):
            out.append(polygon[k - 1] + (polygon[k] - polygon[k - 1]) * (before / (before - here)))
        if here <= _ON_M:
            out.append(polygon[k])
    left = np.array(out).reshape(-1, 2)
    return left if len(left) >= 3 and area(left) > _NONE_M2 else _EMPTY


def outside(polygon: Array, hole: Array) -> list[Array]:
    """Convex pieces of what is left of a polygon beside another one."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    if (hole.max(axis=0) <= low).any() or (hole.min(axis=0) >= high).any():
        return [polygon]
    pieces, left = [], polygon
    for a, b in zip(hole, np.roll(hole, -1, axis=0), strict=True):
        outward = np.array([b[1] - a[1], a[0] - b[0]])
        outward /= float(np.hypot(*outward))
        offset = float(outward @ a)
        if len(piece := cut(left, -outward, -offset)):
            pieces.append(piece)
        left = cut(left, outward, offset)
        if not len(left):
            break
    return pieces if len(left) else [polygon]


def _turn(a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
