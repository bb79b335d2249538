"""Candidate footholds: places in regions, fixed in the world, with their margins to real edges.

A lattice point is a candidate of the region that is on top there. Its key says where it is, and so comes back in the
next frame whatever the superpixels do. The distance to the border of the adjoining superpixel means nothing; what
counts is how far it is to ground that is unknown, or off the candidate's plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.checks import finite
from legtool_runtime.errors import PlannerError
from legtool_runtime.perception.regions import Regions
from legtool_runtime.search.settings import CandidateSettings
from legtool_runtime.search.surface import Outlines, Surface, outlines_of, surface_of
from legtool_runtime.terrain.elevation import HeightMap

Doubles = NDArray[np.float64]

#: Height of a key's cells [m].
_LAYER_M = 0.05
#: A foothold that is planned stays one down to so much of the least margin.
_HELD = 0.5
#: A place in the middle of others counts as better from so much more margin on [m].
_BETTER_M = 0.01
#: Cosine of the angle between planes that are one within the widest margin.
_FLAT = 0.995
#: (16, 2) directions in which a greater circle is looked for.
_WAYS = np.array([[np.cos(way * np.pi / 8), np.sin(way * np.pi / 8)] for way in range(16)])
_BITS, _HALF = 21, 1 << 20
#: Candidates of a frame before they are thinned to those near the torso path.
_MOST = 8192


@dataclass(frozen=True, eq=False)
class Candidates:
    """Places that a foot may be set on.

    Attributes:
        points: (n, 3) contact points, world frame [m].
        normals: (n, 3) of the ground there.
        margins: (n,) distance to the nearest real edge, up to the widest that is measured [m].
        regions: (n,) index of the region; -1 for a foot as it stands.
        keys: (n,) by place, see :func:`keys_of`.
        assumed: (n,) whether the ground there is only assumed.
        dropped: how many others there were.
    """

    points: Doubles
    normals: Doubles
    margins: Doubles
    regions: NDArray[np.int64]
    keys: NDArray[np.int64]
    assumed: NDArray[np.bool_]
    dropped: int = 0

    def __len__(self) -> int:
        return len(self.points)

    def near(self, path: ArrayLike, most: int) -> Candidates:
        """Those nearest to a path (m, 2 or more), world frame [m]; the others are counted."""
        if len(self) <= most:
            return self
        square = _square_to(self.points, np.ascontiguousarray(path, dtype=np.float64))
        kept = np.sort(np.argpartition(square, most)[:most])
        return replace(self._of(kept), dropped=self.dropped + len(self) - most)

    def with_feet(self, feet: ArrayLike, normals: ArrayLike, spacing: float) -> Candidates:
        """These, then four feet (4, 3) as they stand on ground of given normals (4, 3), whatever the regions say."""
        places = np.asarray(feet, dtype=np.float64)
        return Candidates(
            np.concatenate([self.points, places]),
            np.concatenate([self.normals, np.asarray(normals, dtype=np.float64)]),
            np.concatenate([self.margins, np.full(4, np.inf)]),
            np.concatenate([self.regions, np.full(4, -1)]),
            np.concatenate([self.keys, keys_of(places, spacing)]),
            np.concatenate([self.assumed, np.zeros(4, np.bool_)]),
            self.dropped,
        )

    def with_held(self, earlier: Candidates, places: ArrayLike, surface: Surface, s: CandidateSettings) -> Candidates:
        """These, and those of an earlier frame at places (n, 3) that a plan leads to, while half of the least margin is
        left there: what lies along an edge comes and goes with its noise."""
        rows = np.flatnonzero(_at(earlier.points, np.asarray(places, dtype=np.float64).reshape(-1, 3)))
        rows = rows[~np.isin(earlier.keys[rows], self.keys)]
        if not len(rows):
            return self
        held, rules = earlier._of(rows), np.array([s.least_margin, s.wide_margin, s.step, s.radius])
        margins = np.minimum(_margins(surface, held.points, held.normals, rules), held.margins)
        there = margins >= _HELD * s.least_margin
        return Candidates(
            np.concatenate([self.points, held.points[there]]), np.concatenate([self.normals, held.normals[there]]),
            np.concatenate([self.margins, margins[there]]), np.concatenate([self.regions, np.full(there.sum(), -1)]),
            np.concatenate([self.keys, held.keys[there]]), np.concatenate([self.assumed, held.assumed[there]]),
            self.dropped,
        )  # fmt: skip

    def _of(self, rows: NDArray[np.int64]) -> Candidates:
        return Candidates(
            self.points[rows], self.normals[rows], self.margins[rows], self.regions[rows], self.keys[rows],
            self.assumed[rows], self.dropped,
        )  # fmt: skip


def keys_of(points: ArrayLike, spacing: float) -> NDArray[np.int64]:
    """(n,) keys of places (n, 3), world frame [m], on a lattice of candidates with this spacing on wide ground.

    Layers are centred on their heights, so that noise does not change the key of a floor at height 0.
    """
    scale, shift = np.array([0.5 * spacing, 0.5 * spacing, _LAYER_M]), np.array([0.0, 0.0, 0.5])
    cells = np.floor(np.asarray(points, dtype=np.float64) / scale + shift).astype(np.int64) + _HALF
    keys: NDArray[np.int64] = (cells[:, 0] << 2 * _BITS) | (cells[:, 1] << _BITS) | cells[:, 2]
    return keys


def find_candidates(
    regions: Regions,
    *,
    position: ArrayLike,
    settings: CandidateSettings | None = None,
    trunk_width: float = 0.28,
    elevation: HeightMap | None = None,
) -> tuple[Candidates, Surface]:
    """The candidates around the robot, and the ground that they lie on.

    Args:
        regions: planar regions, world frame.
        position: (3,) of the robot's base, world frame [m].
        settings: where footholds are offered.
        trunk_width: of the trunk, which the ground is prepared for [m].
        elevation: heights of what is not steppable too; None: only the regions are known.

    Raises:
        PlannerError: a region whose boundary is not convex and counter-clockwise, or values that are not finite.
    """
    s = settings or CandidateSettings()
    base = finite("candidates: position", position, (3,), PlannerError)
    outlines = outlines_of(regions)
    chosen = outlines.poses[:, 2, 2] >= np.cos(s.steepest)
    assumed = np.asarray(regions.assumed, dtype=np.bool_)
    far = np.hypot(*(outlines.poses[:, :2, 3] - base[:2]).T) > s.assumed_within
    chosen &= ~(assumed & far)
    surface = surface_of(
        outlines, chosen, middle=base[:2], radius=s.radius, cell=s.cell, seam=s.seam, trunk_width=trunk_width,
        elevation=elevation,
    )  # fmt: skip
    points, margins, owners = np.empty((_MOST, 3)), np.empty(_MOST), np.empty(_MOST, dtype=np.int64)
    rules = np.array([s.least_margin, s.wide_margin, s.step, s.radius])
    if s.centroids:
        count, dropped = _centroids(outlines, chosen, surface, base, rules, (points, margins, owners))
    else:
        count, dropped = _lattice(outlines, surface, base, rules, 0.5 * s.spacing, (points, margins, owners))
        count, more = _centres(outlines, chosen, surface, base, rules, s.spacing, (points, margins, owners), count)
        dropped += more
    points, owners = points[:count].copy(), owners[:count].copy()
    found = Candidates(
        points, outlines.poses[owners, :3, 2], margins[:count].copy(), owners, keys_of(points, s.spacing),
        assumed[owners], dropped,
    )  # fmt: skip
    return (found if s.centroids else _once(found)), surface


def _once(candidates: Candidates) -> Candidates:
    """Of equal keys the one with the greatest margin."""
    order = np.lexsort((-candidates.margins, candidates.keys))
    keys = candidates.keys[order]
    first = np.ones(len(keys), dtype=np.bool_)
    first[1:] = keys[1:] != keys[:-1]
    return candidates if first.all() else candidates._of(np.sort(order[first]))


@kernel
def margin_at(surface: Surface, plane: Doubles, x: float, y: float, rules: Doubles) -> float:
    """Horizontal distance from a place to the nearest real edge, up to ``rules[1]`` [m].

    An edge is where no region is, where the region on top is off the plane by more than ``rules[2]``, or where
    something else rises above it. ``plane`` (4, 4) is a region's pose.
    """
    cell, n = surface.cell, surface.owner.shape[0]
    fx, fy = x / cell - surface.low[0], y / cell - surface.low[1]
    i, j = int(np.floor(fx)), int(np.floor(fy))
    most, step = rules[1], rules[2]
    reach = int(np.ceil(most / cell))
    best = most * most
    sx, sy = -plane[0, 2] / plane[2, 2], -plane[1, 2] / plane[2, 2]
    for p in range(i - reach, i + reach + 1):
        dx = max(max(p - fx, fx - p - 1.0), 0.0) * cell
        if dx * dx >= best:
            continue
        for q in range(j - reach, j + reach + 1):
            dy = max(max(q - fy, fy - q - 1.0), 0.0) * cell
            square = dx * dx + dy * dy
            if square >= best:
                continue
            if not (0 <= p < n and 0 <= q < n) or surface.owner[p, q] < 0:
                best = square
                continue
            px, py = (surface.low[0] + p + 0.5) * cell - plane[0, 3], (surface.low[1] + q + 0.5) * cell - plane[1, 3]
            z = plane[2, 3] + sx * px + sy * py
            if abs(surface.height[p, q] - z) > step or surface.ground.heights[p, q] > z + step:
                best = square
    return np.sqrt(best)


@kernel
def _margins(surface: Surface, points: Doubles, normals: Doubles, rules: Doubles) -> Doubles:
    """(n,) distances of points (n, 3) on planes of normals (n, 3) to real edges, see :func:`margin_at`; negative where
    the ground is unknown or at another height."""
    out, plane, n = np.empty(points.shape[0]), np.zeros((4, 4)), surface.owner.shape[0]
    for k in range(points.shape[0]):
        plane[:3, 2], plane[:3, 3] = normals[k], points[k]
        out[k] = margin_at(surface, plane, points[k, 0], points[k, 1], rules)
        p = int(np.floor(points[k, 0] / surface.cell)) - surface.low[0]
        q = int(np.floor(points[k, 1] / surface.cell)) - surface.low[1]
        if not (0 <= p < n and 0 <= q < n) or not abs(surface.height[p, q] - points[k, 2]) <= rules[2]:
            out[k] = -1.0
    return out


@kernel
def _at(points: Doubles, places: Doubles) -> NDArray[np.bool_]:
    """(n,) which points (n, 3) are one of the places (m, 3)."""
    out = np.zeros(points.shape[0], np.bool_)
    for i in range(points.shape[0]):
        for k in range(places.shape[0]):
            d = np.abs(points[i] - places[k])
            out[i] |= d[0] + d[1] + d[2] < 1e-6
    return out


@kernel
def _square_to(points: Doubles, way: Doubles) -> Doubles:
    """(n,) squares of the horizontal distances from points to the nearest of a way's places."""
    out = np.full(points.shape[0], np.inf)
    for c in range(points.shape[0]):
        for k in range(way.shape[0]):
            dx, dy = points[c, 0] - way[k, 0], points[c, 1] - way[k, 1]
            out[c] = min(out[c], dx * dx + dy * dy)
    return out


@kernel
def _near_edges(outlines: Outlines, surface: Surface, reach: int, step: float) -> NDArray[np.bool_]:
    """(n, n) which cells have an edge, or a crease between two planes, within ``reach`` cells and one more."""
    n = surface.owner.shape[0]
    edge, rows, out = np.zeros((n, n), np.bool_), np.zeros((n, n), np.bool_), np.zeros((n, n), np.bool_)
    for i in range(n):
        for j in range(n):
            r = surface.owner[i, j]
            if r < 0 or i == n - 1 or j == n - 1 or surface.ground.heights[i, j] > surface.height[i, j] + 0.5 * step:
                edge[i, j] = True
                continue
            for way in range(2):
                p, q = i + 1 - way, j + way
                other = surface.owner[p, q]
                if other == r or other < 0:
                    continue
                a, b = outlines.poses[r], outlines.poses[other]
                bent = a[0, 2] * b[0, 2] + a[1, 2] * b[1, 2] + a[2, 2] * b[2, 2] < _FLAT
                if bent or abs(surface.height[p, q] - surface.height[i, j]) > 0.5 * step:
                    edge[i, j] = True
    around = reach + 1
    for i in range(n):
        since = 2 * n
        for j in range(n + around):
            since = 0 if j < n and edge[i, j] else since + 1
            if j >= around:
                rows[i, j - around] = since <= 2 * around
    for j in range(n):
        since = 2 * n
        for i in range(n + around):
            since = 0 if i < n and rows[i, j] else since + 1
            if i >= around:
                out[i - around, j] = since <= 2 * around
    return out


@kernel
def _height(plane: Doubles, x: float, y: float) -> float:
    return plane[2, 3] - (plane[0, 2] * (x - plane[0, 3]) + plane[1, 2] * (y - plane[1, 3])) / plane[2, 2]


@kernel
def _put(
    out: tuple[Doubles, Doubles, NDArray[np.int64]],
    count: int,
    point: tuple[float, float, float],
    margin: float,
    r: int,
) -> bool:
    """Write a candidate if there is room."""
    if count >= out[1].shape[0]:
        return False
    out[0][count, 0], out[0][count, 1], out[0][count, 2] = point
    out[1][count], out[2][count] = margin, r
    return True


@kernel
def _lattice(
    outlines: Outlines,
    surface: Surface,
    base: Doubles,
    rules: Doubles,
    step: float,
    out: tuple[Doubles, Doubles, NDArray[np.int64]],
) -> tuple[int, int]:
    """Write each second point of each second row of a lattice with ``step``, and of the points in the middles between
    them those that have two neighbours at most, or are farther from edges than all of them. Returns how many, and how
    many found no room."""
    count, dropped, n = 0, 0, surface.owner.shape[0]
    first_x = int(np.ceil(surface.low[0] * surface.cell / step))
    first_y = int(np.ceil(surface.low[1] * surface.cell / step))
    many = int(n * surface.cell / step)
    near = _near_edges(outlines, surface, int(np.ceil(rules[1] / surface.cell)), rules[2])
    margins, owners = np.full((many, many), -1.0), np.full((many, many), -1)
    for i in range(many):
        for j in range(many):
            x, y = (first_x + i + 0.5) * step, (first_y + j + 0.5) * step
            if (first_x + i + first_y + j) & 1 or np.hypot(x - base[0], y - base[1]) > rules[3]:
                continue
            p, q = int(np.floor(x / surface.cell)) - surface.low[0], int(np.floor(y / surface.cell)) - surface.low[1]
            if not (0 <= p < n and 0 <= q < n) or surface.owner[p, q] < 0:
                continue
            if (first_x + i) & 1 and not near[p, q]:
                continue
            r = surface.owner[p, q]
            margins[i, j] = margin_at(surface, outlines.poses[r], x, y, rules) if near[p, q] else rules[1]
            owners[i, j] = r
    for i in range(many):
        for j in range(many):
            if margins[i, j] < rules[0] or ((first_x + i) & 1 and not _wanted(margins, i, j, rules[0])):
                continue
            x, y = (first_x + i + 0.5) * step, (first_y + j + 0.5) * step
            plane = outlines.poses[owners[i, j]]
            if _put(out, count, (x, y, _height(plane, x, y)), margins[i, j], owners[i, j]):
                count += 1
            else:
                dropped += 1
    return count, dropped


@kernel
def _wanted(margins: Doubles, i: int, j: int, least: float) -> bool:
    """Whether a place in the middle of four has two neighbours at most, or is farther from edges than all of them.

    Those with two line the edges: without them a beam of 0.3 m would have two lanes of footholds 0.2 m apart.
    """
    many, neighbours, best = margins.shape[0], 0, 0.0
    for k in range(4):
        p, q = i + (1 if k & 1 else -1), j + (1 if k & 2 else -1)
        if 0 <= p < many and 0 <= q < many and margins[p, q] >= least:
            neighbours += 1
            best = max(best, margins[p, q])
    return neighbours <= 2 or margins[i, j] > best + _BETTER_M


@kernel
def _sides(outlines: Outlines, r: int) -> Doubles:
    """(k, 5) sides of a region's boundary: where each begins, its way and its length, in the region's plane [m]."""
    first, last = outlines.start[r], outlines.start[r + 1]
    out, count = np.empty((last - first, 5)), 0
    for k in range(first, last):
        m = k + 1 if k + 1 < last else first
        ax, ay = outlines.corners[k, 0], outlines.corners[k, 1]
        ex, ey = outlines.corners[m, 0] - ax, outlines.corners[m, 1] - ay
        length = np.hypot(ex, ey)
        if length > 1e-9:
            out[count, 0], out[count, 1], out[count, 2], out[count, 3], out[count, 4] = ax, ay, ex, ey, length
            count += 1
    return out[:count]


@kernel
def _inside(sides: Doubles, u: float, v: float) -> float:
    """Distance from a place in a region's plane to its boundary, negative outside."""
    best = np.inf
    for k in range(sides.shape[0]):
        best = min(best, (sides[k, 2] * (v - sides[k, 1]) - sides[k, 3] * (u - sides[k, 0])) / sides[k, 4])
    return best


@kernel
def chebyshev_centre(outlines: Outlines, r: int) -> tuple[float, float, float]:
    """Centre of the greatest circle in a region, in its plane, and the circle's radius [m]; to a millimetre.

    The distance to the boundary of a convex polygon is concave, so that a pattern search finds its maximum.
    """
    first, last = outlines.start[r], outlines.start[r + 1]
    u, v, size = 0.0, 0.0, 0.0
    for k in range(first, last):
        u += outlines.corners[k, 0] / (last - first)
        v += outlines.corners[k, 1] / (last - first)
    for k in range(first, last):
        size = max(size, np.hypot(outlines.corners[k, 0] - u, outlines.corners[k, 1] - v))
    sides = _sides(outlines, r)
    best, step = _inside(sides, u, v), 0.5 * size
    while step > 5e-4:
        better = False
        for way in range(16):
            a, b = u + step * _WAYS[way, 0], v + step * _WAYS[way, 1]
            found = _inside(sides, a, b)
            if found > best + 1e-9:
                best, u, v, better = found, a, b, True
                break
        if not better:
            step *= 0.5
    return u, v, best


@kernel
def _centres(
    outlines: Outlines,
    chosen: NDArray[np.bool_],
    surface: Surface,
    base: Doubles,
    rules: Doubles,
    spacing: float,
    out: tuple[Doubles, Doubles, NDArray[np.int64]],
    count: int,
) -> tuple[int, int]:
    """Add the Chebyshev centres of regions that have no candidate near it. Returns as :func:`_lattice` does."""
    has = np.zeros(outlines.poses.shape[0], dtype=np.bool_)
    for k in range(count):
        has[out[2][k]] = True
    lattice, dropped, n = count, 0, surface.owner.shape[0]
    for r in range(outlines.poses.shape[0]):
        pose = outlines.poses[r]
        if has[r] or not chosen[r] or np.hypot(pose[0, 3] - base[0], pose[1, 3] - base[1]) > rules[3] + 0.5:
            continue
        u, v, _ = chebyshev_centre(outlines, r)
        x = pose[0, 0] * u + pose[0, 1] * v + pose[0, 3]
        y = pose[1, 0] * u + pose[1, 1] * v + pose[1, 3]
        z = pose[2, 0] * u + pose[2, 1] * v + pose[2, 3]
        p, q = int(np.floor(x / surface.cell)) - surface.low[0], int(np.floor(y / surface.cell)) - surface.low[1]
        inside = 0 <= p < n and 0 <= q < n and np.hypot(x - base[0], y - base[1]) <= rules[3]
        if not inside or surface.owner[p, q] != r:
            continue
        near = False
        for k in range(lattice):
            away = np.hypot(out[0][k, 0] - x, out[0][k, 1] - y)
            near |= away < 0.8 * spacing and abs(out[0][k, 2] - z) < rules[2]
        margin = margin_at(surface, pose, x, y, rules)
        if near or margin < rules[0]:
            continue
        if _put(out, count, (x, y, z), margin, r):
            count += 1
        else:
            dropped += 1
    return count, dropped


@kernel
def _centroids(
    outlines: Outlines,
    chosen: NDArray[np.bool_],
    surface: Surface,
    base: Doubles,
    rules: Doubles,
    out: tuple[Doubles, Doubles, NDArray[np.int64]],
) -> tuple[int, int]:
    """Write one candidate a region, in its pose, whatever its margin. Returns as :func:`_lattice` does."""
    count, dropped = 0, 0
    for r in range(outlines.poses.shape[0]):
        pose = outlines.poses[r]
        if not chosen[r] or np.hypot(pose[0, 3] - base[0], pose[1, 3] - base[1]) > rules[3]:
            continue
        margin = margin_at(surface, pose, pose[0, 3], pose[1, 3], rules)
        if _put(out, count, (pose[0, 3], pose[1, 3], pose[2, 3]), margin, r):
            count += 1
        else:
            dropped += 1
    return count, dropped
