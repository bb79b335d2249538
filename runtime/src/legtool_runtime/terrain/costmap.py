"""Where a foot may stand, and how far the nearest place is where it may not (motion paper, III-B)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime import checks
from legtool_runtime.cache import kernel
from legtool_runtime.errors import MapError
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.terrain.settings import CostmapSettings

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]


#: Number of unknown cells among nine that is more than speckle: a strip two cells wide has six.
_TOGETHER = 5


@dataclass(frozen=True, eq=False)
class FootCostmap:
    """Safe and unsafe cells, and the distance between them.

    Attributes:
        distance: (n_x, n_y) from each cell's centre to the centre of the nearest unsafe cell [m]: 0 where unsafe,
            infinite where nothing is unsafe. Indexed [ix, iy].
        known: (n_x, n_y) whether the cell has been seen.
        resolution_m: side of a cell.
        lower_corner: (2,) x, y of the outer corner of cell (0, 0), world frame [m].
        unknown_unsafe: whether unseen cells and everything beyond the map count as unsafe.
    """

    distance: Array32
    known: Mask
    resolution_m: float
    lower_corner: Array
    unknown_unsafe: bool

    @cached_property
    def seen(self) -> bool:
        """Whether any cell has been seen."""
        return bool(self.known.any())

    @property
    def unsafe(self) -> Mask:
        """(n_x, n_y) cells where no foot may stand."""
        return np.equal(self.distance, 0.0)

    def contains(self, point: ArrayLike) -> bool:
        """Whether the point x, y (world frame [m]) lies on the map."""
        cell = self._cells(np.array(point, dtype=np.float64)[None, :2])
        return bool(((cell >= 0) & (cell < self.distance.shape)).all())

    def distance_at(self, points: ArrayLike) -> Array32:
        """Return the distance from the cell of each point to the nearest unsafe cell.

        Args:
            points: (n, 2 or 3) world frame [m].

        Returns:
            (n,) [m]; beyond the map 0 if unknown cells are unsafe, otherwise infinite.
        """
        cell = self._cells(np.array(points, dtype=np.float64)[:, :2])
        inside = ((cell >= 0) & (cell < self.distance.shape)).all(axis=1)
        out = np.full(len(cell), 0.0 if self.unknown_unsafe else np.inf, np.float32)
        out[inside] = self.distance[cell[inside, 0], cell[inside, 1]]
        return out

    def _cells(self, points: Array) -> NDArray[np.int64]:
        cells = np.floor((points - self.lower_corner) / self.resolution_m)
        return np.nan_to_num(cells, nan=-1.0).clip(-1, 1 << 30).astype(np.int64)


def foot_cost(distance: ArrayLike, d_max: float) -> Array:
    """Return d_foot of one foot [m]: d_max - d if the distance d to the nearest unsafe cell is below d_max, else 0."""
    d = np.asarray(distance, dtype=np.float64)
    return np.where(d < d_max, d_max - d, 0.0)


def foot_costmap(heights: HeightMap, settings: CostmapSettings | None = None) -> FootCostmap:
    """Mark the unsafe cells of an elevation map and compute the distance to them.

    Args:
        heights: the map; NaN where unknown.
        settings: thresholds.

    Raises:
        MapError: no map.
    """
    checks.instance("elevation", heights, HeightMap, MapError)
    s = settings or CostmapSettings()
    r = heights.resolution_m
    windows = (s.window_m, s.step_window_m, s.drop_window_m)
    near, step, far = (max(1, round(0.5 * window / r)) for window in windows)
    unsafe = np.empty(heights.heights.shape, np.bool_)
    _flag(heights.heights, near, step, far, s.height_threshold_m, s.drop_threshold_m, s.unknown_unsafe, unsafe)
    return _with_distance(unsafe, ~np.isnan(heights.heights), r, heights.lower_corner, s.unknown_unsafe)


def costmap_from_mask(
    unsafe: ArrayLike, resolution_m: float, *, center: ArrayLike, unknown_unsafe: bool = True
) -> FootCostmap:
    """Build a costmap from unsafe cells that were determined elsewhere; every cell counts as seen.

    Args:
        unsafe: (n_x, n_y) truth values, indexed [ix, iy].
        resolution_m: side of a cell.
        center: (2,) x, y of the middle of the map, world frame [m].
        unknown_unsafe: whether everything beyond the map counts as unsafe.

    Raises:
        MapError: the mask, the resolution or the centre is not valid.
    """
    mask = np.array(unsafe, dtype=np.bool_)
    checked = HeightMap(mask.astype(np.float32), resolution_m, np.asarray(center))
    return _with_distance(mask, np.ones_like(mask), resolution_m, checked.lower_corner, unknown_unsafe)


def _with_distance(unsafe: Mask, known: Mask, resolution: float, corner: Array, unknown_unsafe: bool) -> FootCostmap:
    distance = np.empty(unsafe.shape, np.float32)
    _distance_transform(unsafe, resolution, unknown_unsafe, distance)
    return FootCostmap(distance, known, float(resolution), corner, unknown_unsafe)


@kernel
def _flag(
    heights: Array32, near: int, step: int, far: int, rough: float, drop: float, unknown_unsafe: bool, unsafe: Mask
) -> None:
    nx, ny = heights.shape
    depth, high = np.empty_like(heights), np.empty_like(heights)
    for ix in range(nx):
        for iy in range(ny):
            h = heights[ix, iy]
            known = h == h  # NaN differs from itself
            depth[ix, iy] = -h if known else -np.inf
            high[ix, iy] = h if known else -np.inf
    highest, deepest = _window_max(high, near), _window_max(depth, near)
    above, below = _window_max(high, far), _window_max(depth, step)
    if unknown_unsafe:
        hidden = _window_max(_unseen_together(heights), near)
    else:
        hidden = np.zeros_like(heights)
    for ix in range(nx):
        for iy in range(ny):  # without branches: vector code
            h = heights[ix, iy]
            lower = h + below[ix, iy]  # than the cell is the lowest ground nearby
            bad = (highest[ix, iy] + deepest[ix, iy] > rough) | (above[ix, iy] - h > drop) | (hidden[ix, iy] > 0)
            bad |= (lower > rough) & (lower < drop)
            unsafe[ix, iy] = ((h == h) & bad) | ((h != h) & unknown_unsafe)


@kernel
def _unseen_together(heights: Array32) -> Array32:
    """1 for unknown cells in mostly unknown neighbourhoods of 3 × 3 cells, such as those behind an edge."""
    nx, ny = heights.shape
    unknown = np.zeros((nx, ny + 2), np.float32)
    for ix in range(nx):
        for iy in range(ny):
            h = heights[ix, iy]
            unknown[ix, iy + 1] = np.float32(1) if h != h else np.float32(0)
    out = np.zeros_like(heights)
    for ix in range(1, nx - 1):
        before, here, after, row = unknown[ix - 1], unknown[ix], unknown[ix + 1], out[ix]
        for iy in range(ny):
            count = np.float32(0)
            for shift in range(3):
                count += before[iy + shift] + here[iy + shift] + after[iy + shift]
            row[iy] = here[iy + 1] if count >= _TOGETHER else np.float32(0)
    return out


@kernel
def _window_max(grid: Array32, reach: int) -> Array32:
    """Greatest value in the square of ± ``reach`` cells, along one axis after the other."""
    nx, ny = grid.shape
    along = grid.copy()
    for ix in range(nx):
        for shift in range(1, min(reach, ny - 1) + 1):
            row, ahead = along[ix, : ny - shift], grid[ix, shift:]
            for k in range(ny - shift):
                row[k] = max(row[k], ahead[k])
            row, ahead = along[ix, shift:], grid[ix, : ny - shift]
            for k in range(ny - shift):
                row[k] = max(row[k], ahead[k])
    out = along.copy()
    for ix in range(nx):
        row = out[ix]
        for other in range(max(ix - reach, 0), min(ix + reach, nx - 1) + 1):
            ahead = along[other]
            for k in range(ny):
                row[k] = max(row[k], ahead[k])
    return out


@kernel
def _distance_transform(unsafe: Mask, resolution: float, border: bool, distance: Array32) -> None:
    """Exact Euclidean distance to the nearest unsafe cell, in time linear in the number of cells.

    Along x by two scans over whole rows, along y by the lower envelope of parabolas (Felzenszwalb and Huttenlocher,
    2012). With ``border`` the cells around the map are unsafe.
    """
    nx, ny = unsafe.shape
    none = np.float32(nx + ny)  # farther than any cell
    along = np.empty((nx, ny), np.float32)  # cells to the nearest unsafe one along x: whole numbers, exact
    outside = np.full(ny, 0 if border else none, np.float32)
    for ix in range(nx):
        row, above = along[ix], along[ix - 1] if ix else outside
        for iy in range(ny):
            row[iy] = 0 if unsafe[ix, iy] else min(above[iy] + 1, none)
    for ix in range(nx - 1, -1, -1):
        row, below = along[ix], along[ix + 1] if ix < nx - 1 else outside
        for iy in range(ny):
            row[iy] = min(row[iy], below[iy] + 1)
    square = np.arange(ny + 1.0) ** 2
    half = 0.5 / np.maximum(np.arange(ny), 1)
    lift = np.empty(ny)  # squared distance along x, plus q²
    lowest = np.empty(ny, np.int64)  # apex of each parabola of the envelope
    start = np.empty(ny + 1)  # from where on it is the lowest
    nearest = np.empty(ny)
    limit = resolution * none
    for ix in range(nx):
        row = along[ix]
        for q in range(ny):
            lift[q] = row[q] * row[q] + square[q]
        k, v, since, raised = 0, 0, -np.inf, lift[0]
        lowest[0], start[0] = v, since
        for q in range(1, ny):
            s = (lift[q] - raised) * half[q - v]
            while s <= since:
                k -= 1
                v = lowest[k]
                since, raised = start[k], lift[v]
                s = (lift[q] - raised) * half[q - v]
            k += 1
            v, since, raised = q, s, lift[q]
            lowest[k], start[k] = v, since
        first = 0
        for i in range(k + 1):
            last = min(int(np.floor(start[i + 1])) + 1, ny) if i < k else ny
            v = lowest[i]
            away = row[v] * row[v]
            for q in range(first, last):
                nearest[q] = float(q - v) * float(q - v) + away
            first = max(first, last)
        out = distance[ix]
        for q in range(ny):
            d = nearest[q]
            if border:
                d = min(d, min(square[q + 1], square[ny - q]))
            d = resolution * np.sqrt(d)
            out[q] = d if d < limit else np.inf
