"""A height surface that rays meet: a grid of heights, two triangles to a cell, as MuJoCo's height field has them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.sim.worlds.rays import PixelRays, pixel_ray
from legtool_runtime.cache import kernel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface over a rectangle of the world.

    Attributes:
        heights: (nx, ny) at the grid's points, world frame [m], indexed [ix, iy].
        resolution_m: distance between points.
        origin: (2,) world x, y of point (0, 0) [m].
    """

    heights: Array
    resolution_m: float
    origin: Array

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Height of the triangles at world x, y [m]; -inf outside the rectangle."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        fx, fy = (x - self.origin[0]) / self.resolution_m, (y - self.origin[1]) / self.resolution_m
        nx, ny = self.heights.shape
        inside = (fx >= 0) & (fx <= nx - 1) & (fy >= 0) & (fy <= ny - 1)
        ix = np.clip(fx.astype(int), 0, nx - 2)
        iy = np.clip(fy.astype(int), 0, ny - 2)
        fx, fy, h = fx - ix, fy - iy, self.heights
        h00, h11 = h[ix, iy], h[ix + 1, iy + 1]
        lower = h00 + fx * (h[ix + 1, iy] - h00) + fy * (h11 - h[ix + 1, iy])
        upper = h00 + fy * (h[ix, iy + 1] - h00) + fx * (h11 - h[ix, iy + 1])
        return np.where(inside, np.where(fx >= fy, lower, upper), -np.inf)


class HeightGrid(NamedTuple):
    """A surface for kernels: heights (nx, ny) [m], distance between points [m], (2,) world x, y of point (0, 0)."""

    heights: Array
    resolution: float
    corner: Array


def grid_of(surface: Surface | None) -> HeightGrid:
    """The surface's grid; without a surface one that lies nowhere."""
    if surface is None:
        return HeightGrid(np.zeros((2, 2)), 1.0, np.full(2, np.inf))
    return HeightGrid(surface.heights, float(surface.resolution_m), np.asarray(surface.origin, dtype=float))


def cell_tops(heights: Array) -> Array:
    """(nx - 1, ny - 1) highest point of each cell."""
    pairs = np.maximum(heights[1:], heights[:-1])
    return np.maximum(pairs[:, 1:], pairs[:, :-1])


@kernel
def _meet_cell(heights: Array, i: int, j: int, o: tuple, d: tuple, low: float, high: float) -> float:
    """First t in [low, high] at which the ray, in units of cells and metres, meets a triangle of cell (i, j)."""
    h00, h10, h01, h11 = heights[i, j], heights[i + 1, j], heights[i, j + 1], heights[i + 1, j + 1]
    x, y = o[0] - i, o[1] - j
    best = np.inf
    for triangle in range(2):
        gx, gy = (h10 - h00, h11 - h10) if triangle == 0 else (h11 - h01, h01 - h00)
        slope = gx * d[0] + gy * d[1] - d[2]
        if slope == 0.0:
            continue
        t = (o[2] - h00 - gx * x - gy * y) / slope
        side = (x + t * d[0]) - (y + t * d[1])
        right_side = side >= -1e-9 if triangle == 0 else side <= 1e-9
        if low - 1e-9 <= t <= high + 1e-9 and right_side and 0.0 < t < best:
            best = t
    return best


@kernel
def meet_surface(heights: Array, tops: Array, highest: float, o: tuple, d: tuple, limit: float) -> float:
    """First t in (0, limit) at which a ray meets the surface, inf where it does not.

    Args:
        heights, tops: the surface, and its cells' highest points [m].
        highest: the surface's highest point [m].
        o, d: the ray, x and y in cells from the grid's first point, z in metres.
        limit: something nearer is known to be there.
    """
    nx, ny = tops.shape
    start, end = 0.0, limit
    for k in range(2):
        size = float(nx if k == 0 else ny)
        if abs(d[k]) < 1e-12:
            if not 0.0 <= o[k] <= size:
                return np.inf
            continue
        a, b = -o[k] / d[k], (size - o[k]) / d[k]
        start, end = max(start, min(a, b)), min(end, max(a, b))
    if o[2] + start * d[2] > highest:
        if d[2] >= 0.0:
            return np.inf
        start = (highest - o[2]) / d[2]
    if start >= end:
        return np.inf
    i = min(max(int(o[0] + start * d[0]), 0), nx - 1)
    j = min(max(int(o[1] + start * d[1]), 0), ny - 1)
    step_i, step_j = (1 if d[0] > 0.0 else -1), (1 if d[1] > 0.0 else -1)
    per_i = abs(1.0 / d[0]) if abs(d[0]) > 1e-12 else np.inf
    per_j = abs(1.0 / d[1]) if abs(d[1]) > 1e-12 else np.inf
    next_i = (i + (1 if step_i > 0 else 0) - o[0]) / d[0] if per_i < np.inf else np.inf
    next_j = (j + (1 if step_j > 0 else 0) - o[1]) / d[1] if per_j < np.inf else np.inf
    t = start
    while t < end:
        leave = min(next_i, next_j, end)
        if min(o[2] + t * d[2], o[2] + leave * d[2]) <= tops[i, j] + 1e-9:
            hit = _meet_cell(heights, i, j, o, d, t, leave)
            if hit < limit:
                return hit
        if next_i <= next_j:
            i += step_i
            t = next_i
            next_i += per_i
            if not 0 <= i < nx:
                break
        else:
            j += step_j
            t = next_j
            next_j += per_j
            if not 0 <= j < ny:
                break
    return np.inf


@kernel
def cast_surface(
    geom: int, grid: HeightGrid, tops: Array, view: PixelRays, depth: Array, geoms: NDArray[np.int32]
) -> None:
    """Draw the surface, number ``geom``, into ``depth`` (h, w) and ``geoms`` where it is nearest."""
    turn = view.turn
    highest = tops.max()
    scale = 1.0 / grid.resolution
    o = (
        (view.position[0] - grid.corner[0]) * scale,
        (view.position[1] - grid.corner[1]) * scale,
        view.position[2],
    )
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            dx, dy, dz = pixel_ray(view, turn, u, v)
            t = meet_surface(grid.heights, tops, highest, o, (dx * scale, dy * scale, dz), depth[v, u])
            if t < depth[v, u]:
                depth[v, u] = t
                geoms[v, u] = geom


@kernel
def surface_normals(
    geom: int, grid: HeightGrid, view: PixelRays, depth: Array, geoms: NDArray[np.int32], normals: NDArray[np.float32]
) -> None:
    """World normals (h, w, 3), upward, of the pixels that show the surface, number ``geom``."""
    heights, resolution, turn = grid.heights, grid.resolution, view.turn
    nx, ny = heights.shape[0] - 1, heights.shape[1] - 1
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if geoms[v, u] != geom:
                continue
            t = depth[v, u]
            dx, dy, _ = pixel_ray(view, turn, u, v)
            x = (view.position[0] + t * dx - grid.corner[0]) / resolution
            y = (view.position[1] + t * dy - grid.corner[1]) / resolution
            i, j = min(max(int(x), 0), nx - 1), min(max(int(y), 0), ny - 1)
            h00, h10, h01, h11 = heights[i, j], heights[i + 1, j], heights[i, j + 1], heights[i + 1, j + 1]
            lower = x - i >= y - j
            gx = (h10 - h00 if lower else h11 - h01) / resolution
            gy = (h11 - h10 if lower else h01 - h00) / resolution
            length = np.sqrt(gx * gx + gy * gy + 1.0)
            normals[v, u, 0], normals[v, u, 1], normals[v, u, 2] = -gx / length, -gy / length, 1.0 / length
