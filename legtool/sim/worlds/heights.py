"""A world's ground truth as an elevation map."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from legtool.sim.worlds.world import World
from legtool_runtime.terrain.elevation import HeightMap


def elevation_map(
    world: World, centre_xy: ArrayLike, size_m: float | tuple[float, float], resolution_m: float
) -> HeightMap:
    """True heights around a place, at the middles of cells whose edges lie on whole multiples of their side.

    Args:
        world: what is mapped.
        centre_xy: (2,) world x, y near the map's centre [m].
        size_m: lengths of its sides along x and y; one number: a square [m].
        resolution_m: side of a cell [m].

    Returns:
        the map; NaN where there is nothing.
    """
    r = resolution_m
    count = np.round(np.broadcast_to(size_m, 2) / np.float64(r)).astype(int)
    first = np.round(np.asarray(centre_xy, dtype=float)[:2] / r - 0.5 * count)
    x, y = ((first[k] + np.arange(count[k]) + 0.5) * r for k in range(2))
    heights = world.height(x[:, None], y[None, :])
    heights[np.isinf(heights)] = np.nan
    return HeightMap(heights.astype(np.float32), r, (first + 0.5 * count) * r)
