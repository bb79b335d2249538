"""The ground near the robot as a raster: where which region is on top, and what legs and trunk must clear."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.checks import ROTATION_TOLERANCE
from legtool_runtime.errors import PlannerError
from legtool_runtime.perception.regions import Regions
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.ground import Ground, ground_of

Doubles = NDArray[np.float64]

#: Corners of a region's boundary that bend inwards by less than this count as straight [rad].
_BENT = 0.02
#: Cells of the raster in one of the coarse map that the trunk is held against.
COARSE = 3
#: Gaps in one plane: how far its two sides may differ in height [m].
_ONE_PLANE = 0.03
#: Twice the area of what is a line or a point [m²].
_NO_AREA = 1e-9
_FAULTS = (
    "",
    "fewer than 3 corners",
    "corners that are not finite",
    "corners in clockwise order",
    "no convex boundary",
    "a boundary around no area",
)


class Surface(NamedTuple):
    """A window of the world, aligned with it.

    ``owner`` (n, n): region on top in each cell, -1 none; ``height`` (n, n): of its plane at the cell's centre [m], NaN
    where none; ``ground``: highest of regions and elevation map; ``trunk``: the same, COARSE times as coarse, each
    cell the highest within a trunk's half-width; ``low`` (2,) cell indices of the lower corner; ``cell`` [m].
    """

    owner: NDArray[np.int32]
    height: Doubles
    ground: Ground
    trunk: Ground
    low: NDArray[np.int64]
    cell: float


class Outlines(NamedTuple):
    """Regions for compiled code: ``poses`` (k, 4, 4), corners of all (m, 2), and where each region's begin (k + 1,)."""

    poses: Doubles
    corners: Doubles
    start: NDArray[np.int64]


def outlines_of(regions: Regions) -> Outlines:
    """Regions as compiled code reads them.

    Raises:
        PlannerError: poses that are not finite, or a boundary that is not convex and counter-clockwise.
    """
    poses = np.ascontiguousarray(regions.poses, dtype=np.float64).reshape(-1, 4, 4)
    if len(regions.boundaries) != len(poses):
        raise PlannerError(f"regions: {len(regions.boundaries)} boundaries of {len(poses)} regions")
    for index, corners in enumerate(regions.boundaries):
        if np.ndim(corners) != 2 or np.shape(corners)[1] != 2:
            raise PlannerError(
                f"regions: the boundary of region {index} has shape {np.shape(corners)}, expected (n, 2)"
            )
    start = np.zeros(len(poses) + 1, dtype=np.int64)
    np.cumsum([len(b) for b in regions.boundaries], out=start[1:])
    corners = np.concatenate([*regions.boundaries, np.empty((0, 2))]).astype(np.float64)
    finite = np.isfinite(poses).all(axis=(1, 2))
    if not finite.all():
        raise PlannerError(f"regions: the pose of region {int(np.argmin(finite))} holds a value that is not finite")
    turns = poses[:, :3, :3]
    off = np.abs(turns @ np.swapaxes(turns, 1, 2) - np.eye(3)).max(axis=(1, 2))
    rigid = (off <= ROTATION_TOLERANCE) & (np.linalg.det(turns) > 0.0)
    if not rigid.all():
        raise PlannerError(f"regions: the pose of region {int(np.argmin(rigid))} is no rotation and translation")
    outlines = Outlines(poses, corners, start)
    index, fault = _fault(outlines, _BENT)
    if fault:
        raise PlannerError(
            f"regions: region {index} has {_FAULTS[fault]}; expected a convex boundary, counter-clockwise"
        )
    return outlines


@kernel
def _fault(outlines: Outlines, bent: float) -> tuple[int, int]:
    """The first region whose boundary cannot be used, and why; 0 for none."""
    for r in range(outlines.start.shape[0] - 1):
        first, n = outlines.start[r], outlines.start[r + 1] - outlines.start[r]
        if n < 3:
            return r, 1
        area, worst = 0.0, 0.0
        for k in range(n):
            a, b = outlines.corners[first + k], outlines.corners[first + (k + 1) % n]
            c = outlines.corners[first + (k + 2) % n]
            if not np.isfinite(a[0] + a[1]):
                return r, 2
            area += a[0] * b[1] - b[0] * a[1]
            ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], c[0] - b[0], c[1] - b[1]
            lengths = np.hypot(ux, uy) * np.hypot(vx, vy)
            if lengths > 1e-12:
                worst = min(worst, (ux * vy - uy * vx) / lengths)
        if abs(area) <= _NO_AREA:
            return r, 5
        if area < 0.0:
            return r, 3
        if worst < -bent:
            return r, 4
    return 0, 0


def surface_of(
    outlines: Outlines,
    chosen: NDArray[np.bool_],
    *,
    middle: ArrayLike,
    radius: float,
    cell: float,
    seam: float,
    trunk_width: float,
    elevation: HeightMap | None = None,
) -> Surface:
    """The raster of regions around a place.

    Args:
        outlines: of the regions.
        chosen: (k,) which of them count.
        middle: (2,) of the window, world frame [m].
        radius: half of its side [m].
        cell: its resolution [m].
        seam: gaps in one plane up to this wide are closed [m].
        trunk_width: of the trunk [m].
        elevation: the ground besides the regions: walls, obstacles.
    """
    n = COARSE * int(np.ceil(2.0 * radius / (COARSE * cell)))
    low = np.floor(np.asarray(middle, dtype=np.float64) / (COARSE * cell)).astype(np.int64) * COARSE - n // 2
    owner, height = np.full((n, n), -1, dtype=np.int32), np.full((n, n), np.nan)
    _fill(outlines, chosen, low, cell, owner, height)
    _close(owner, height, int(seam / cell + 1e-6))
    top = height.astype(np.float32)
    if elevation is not None:
        _raise(ground_of(elevation), low, cell, top)
    coarse = np.full((n // COARSE, n // COARSE), np.nan, dtype=np.float32)
    _highest(top, COARSE, int(np.ceil(0.5 * trunk_width / (COARSE * cell))), coarse)
    x, y = float(low[0]) * cell, float(low[1]) * cell
    return Surface(owner, height, Ground(top, cell, x, y), Ground(coarse, COARSE * cell, x, y), low, cell)


@kernel
def _fill(
    outlines: Outlines,
    chosen: NDArray[np.bool_],
    low: NDArray[np.int64],
    cell: float,
    owner: NDArray[np.int32],
    height: Doubles,
) -> None:
    """Write which region is on top in each cell whose centre it covers, and the height of its plane there."""
    n = owner.shape[0]
    xy = np.empty((outlines.corners.shape[0], 2))
    for r in range(outlines.start.shape[0] - 1):
        if not chosen[r]:
            continue
        pose = outlines.poses[r]
        nx, ny, nz = pose[0, 2], pose[1, 2], pose[2, 2]
        first, last = outlines.start[r], outlines.start[r + 1]
        left, right = np.inf, -np.inf
        for k in range(first, last):
            u, v = outlines.corners[k, 0], outlines.corners[k, 1]
            # In units of cells, so that centres lie at integers.
            xy[k, 0] = (pose[0, 0] * u + pose[0, 1] * v + pose[0, 3]) / cell - low[0] - 0.5
            xy[k, 1] = (pose[1, 0] * u + pose[1, 1] * v + pose[1, 3]) / cell - low[1] - 0.5
            left, right = min(left, xy[k, 0]), max(right, xy[k, 0])
        for i in range(int(max(np.ceil(left), 0.0)), int(min(np.floor(right), n - 1.0)) + 1):
            below, above = np.inf, -np.inf
            for k in range(first, last):
                m = k + 1 if k + 1 < last else first
                ax, bx = xy[k, 0], xy[m, 0]
                if (ax <= i <= bx) or (bx <= i <= ax):
                    ay, by = xy[k, 1], xy[m, 1]
                    y = ay if ax == bx else ay + (by - ay) * (i - ax) / (bx - ax)
                    below, above = min(below, y), max(above, y)
                    if ax == bx:
                        below, above = min(below, by), max(above, by)
            for j in range(int(max(np.ceil(below), 0.0)), int(min(np.floor(above), n - 1.0)) + 1):
                x, y = (low[0] + i + 0.5) * cell - pose[0, 3], (low[1] + j + 0.5) * cell - pose[1, 3]
                z = pose[2, 3] - (nx * x + ny * y) / nz
                if owner[i, j] < 0 or z > height[i, j]:
                    owner[i, j], height[i, j] = r, z


@kernel
def _close(owner: NDArray[np.int32], height: Doubles, widest: int) -> None:
    """Close gaps of up to ``widest`` cells between two sides in one plane, along rows, columns and diagonals."""
    n = owner.shape[0]
    if widest < 1:
        return
    found = owner.copy()
    edges, count = np.empty(((n - 2) * (n - 2), 2), np.int32), 0
    for i in range(1, n - 1):
        for j in range(1, n - 1):
            beside = min(min(found[i + 1, j], found[i, j + 1]), min(found[i + 1, j + 1], found[i + 1, j - 1]))
            if found[i, j] >= 0 and beside < 0:
                edges[count, 0], edges[count, 1] = i, j
                count += 1
    for way in range(4):
        dx, dy = (1, 0, 1, 1)[way], (0, 1, 1, -1)[way]
        for e in range(count):
            # Only at cells that begin a gap: covered, and the next one is not.
            i, j = edges[e, 0], edges[e, 1]
            if found[i + dx, j + dy] >= 0:
                continue
            for width in range(1, widest + 1):
                x, y = i + (width + 1) * dx, j + (width + 1) * dy
                if x >= n or y >= n or y < 0:
                    break
                if found[x, y] < 0:
                    continue
                if abs(height[x, y] - height[i, j]) <= _ONE_PLANE * (width + 1):
                    for k in range(1, width + 1):
                        p, q = i + k * dx, j + k * dy
                        if owner[p, q] < 0:
                            share = k / (width + 1)
                            owner[p, q] = found[i, j] if share < 0.5 else found[x, y]
                            height[p, q] = (1.0 - share) * height[i, j] + share * height[x, y]
                break


@kernel
def _raise(elevation: Ground, low: NDArray[np.int64], cell: float, top: NDArray[np.float32]) -> None:
    """Raise the ground to what an elevation map holds."""
    columns = np.empty(top.shape[1], np.int64)
    for j in range(top.shape[1]):
        columns[j] = int(np.floor(((low[1] + j + 0.5) * cell - elevation.low_y) / elevation.cell))
    for i in range(top.shape[0]):
        row = int(np.floor(((low[0] + i + 0.5) * cell - elevation.low_x) / elevation.cell))
        if not 0 <= row < elevation.heights.shape[0]:
            continue
        for j in range(top.shape[1]):
            if 0 <= columns[j] < elevation.heights.shape[1]:
                z = elevation.heights[row, columns[j]]
                if np.isfinite(z) and not top[i, j] >= z:
                    top[i, j] = z


@kernel
def _highest(top: NDArray[np.float32], block: int, around: int, out: NDArray[np.float32]) -> None:
    """Write the highest of each block of cells and of ``around`` blocks on each side."""
    m = out.shape[0]
    blocks, rows = np.full((m, m), -np.inf), np.full((m, m), -np.inf)
    for i in range(m):
        for j in range(m):
            for p in range(block * i, block * (i + 1)):
                for q in range(block * j, block * (j + 1)):
                    if top[p, q] > blocks[i, j]:
                        blocks[i, j] = top[p, q]
    for i in range(m):
        for j in range(m):
            for k in range(max(i - around, 0), min(i + around + 1, m)):
                rows[i, j] = max(rows[i, j], blocks[k, j])
    for i in range(m):
        for j in range(m):
            best = -np.inf
            for k in range(max(j - around, 0), min(j + around + 1, m)):
                best = max(best, rows[i, k])
            if best > -np.inf:
                out[i, j] = best
