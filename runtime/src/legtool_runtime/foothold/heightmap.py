"""Cutting the heightmaps of ViTAL's tuple out of an elevation map, and choosing among their safe cells."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.errors import MapError
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE
from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]


def extract_heightmap(
    elevation: HeightMap, center: ArrayLike, *, yaw: float, resample: bool = False, outside: bool = False
) -> Array32:
    """Cut a (33, 33) map at 2 cm, x along ``yaw``, by the nearest cell: between cells no height is invented.

    Args:
        elevation: heights in the world.
        center: (2,) x, y of the map's centre, world frame [m].
        yaw: of the horizontal frame [rad].
        resample: take an elevation map of another resolution too.
        outside: take a centre off the map too.

    Returns:
        heights [m], world frame, indexed [ix, iy]; NaN where unknown or off the map.

    Raises:
        MapError: the centre is off the map, or the map's resolution is not 2 cm and ``resample`` was not asked for.
    """
    if abs(elevation.resolution_m - RESOLUTION_M) > 1e-6 and not resample:
        raise MapError(
            f"map: resolution_m is {elevation.resolution_m}, heightmaps have {RESOLUTION_M}; "
            "make the map at that resolution, or ask for resampling with resample=True"
        )
    low = elevation.lower_corner
    high = low + elevation.resolution_m * np.array(elevation.heights.shape)
    x, y = (float(value) for value in np.asarray(center, dtype=np.float64))
    if not outside and not (low[0] <= x < high[0] and low[1] <= y < high[1]):
        raise MapError(
            f"map: ({x:.2f}, {y:.2f}) m, where a heightmap's centre should be, lies outside of the map, which goes "
            f"from ({low[0]:.2f}, {low[1]:.2f}) to ({high[0]:.2f}, {high[1]:.2f}) m"
        )
    out = np.empty((SIZE, SIZE), np.float32)
    turn = (math.cos(yaw), math.sin(yaw))
    _extract(elevation.heights, elevation.resolution_m, low[0], low[1], (x, y), turn, out)
    return out


@kernel
def _extract(
    heights: Array32,
    resolution: float,
    low_x: float,
    low_y: float,
    center: tuple[float, float],
    turn: tuple[float, float],
    out: Array32,
) -> None:
    n, half = out.shape[0], out.shape[0] // 2
    c, s = turn
    for i in range(n):
        for j in range(n):
            x, y = (i - half) * RESOLUTION_M, (j - half) * RESOLUTION_M
            # A hair's breadth off the cells' borders, where rounding would decide.
            u = int(np.floor((center[0] + c * x - s * y - low_x) / resolution + 1e-6))
            v = int(np.floor((center[1] + s * x + c * y - low_y) / resolution + 1e-6))
            if 0 <= u < heights.shape[0] and 0 <= v < heights.shape[1]:
                out[i, j] = heights[u, v]
            else:
                out[i, j] = np.float32(np.nan)


@kernel
def median_height(heights: Array32) -> float:
    """Median of what is known of ``heights`` (...) [m]; NaN if nothing is."""
    return float(np.nanmedian(heights))


def nearest_safe(
    safe: NDArray[np.bool_], direction: Sequence[float], *, sideways: float = 1.0, most_sideways_m: float = math.inf
) -> tuple[int, int] | None:
    """The safe cell nearest to the map's centre; ties by angle from the direction of travel, left before right.

    Args:
        safe: (33, 33).
        direction: (2,) of travel, horizontal frame; along x when standing.
        sideways: factor of distances along y: steps to the side cost a walking robot its balance.
        most_sideways_m: cells farther to the side are refused.

    Returns:
        ix, iy; None where no cell is safe.
    """
    speed = math.hypot(direction[0], direction[1])
    x, y = (direction[0] / speed, direction[1] / speed) if speed > 1e-3 else (1.0, 0.0)
    cell = _nearest(np.ascontiguousarray(safe), float(x), float(y), float(sideways), most_sideways_m / RESOLUTION_M)
    return None if cell < 0 else divmod(int(cell), safe.shape[1])


@kernel
def _nearest(safe: NDArray[np.bool_], x: float, y: float, sideways: float, most_sideways: float) -> int:
    half = safe.shape[0] // 2
    best, best_distance, best_along, best_left = -1, np.inf, 0.0, 0.0
    for i in range(safe.shape[0]):
        for j in range(safe.shape[1]):
            if not safe[i, j]:
                continue
            di, dj = i - half, j - half
            if abs(dj) > most_sideways:
                continue
            distance = di * di + sideways * sideways * dj * dj
            along, left = di * x + dj * y, dj * x - di * y
            # At one distance a smaller angle from the direction of travel means farther along it.
            if distance < best_distance or (
                distance == best_distance
                and (along > best_along + 1e-6 or (along > best_along - 1e-6 and left > best_left))
            ):
                best, best_distance, best_along, best_left = i * safe.shape[1] + j, distance, along, left
    return best


def warm_up() -> None:
    """Compile all kernels, or load them from the user's cache."""
    flat = HeightMap(np.zeros((2 * SIZE, 2 * SIZE), np.float32), RESOLUTION_M, np.zeros(2))
    heights = extract_heightmap(flat, (0.0, 0.0), yaw=0.0)
    median_height(np.zeros((4, SIZE, SIZE), np.float32))
    nearest_safe(np.isfinite(heights), (1.0, 0.0))
