"""A world's ground truth as an elevation map."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from legtool.sim.worlds.world import World
from legtool_runtime.terrain.elevation import HeightMap


class TrueHeights:
    """True heights around one place after another: made once over an area, and cut from there.

    A world of many boxes that are turned anyhow takes a tenth of a second for each map otherwise.
    """

    def __init__(self, world: World, low: ArrayLike, high: ArrayLike, resolution_m: float) -> None:
        """Make the map of an area.

        Args:
            world: what is mapped.
            low, high: (2,) corners of the area, world x, y [m].
            resolution_m: side of a cell [m].
        """
        corners = np.array([low, high], dtype=float)
        size = np.ceil((corners[1] - corners[0]) / resolution_m) * resolution_m
        self._world = world
        self._all = elevation_map(world, corners.mean(axis=0), (float(size[0]), float(size[1])), resolution_m)

    def around(self, centre_xy: ArrayLike, size_m: float) -> HeightMap:
        """What :func:`elevation_map` gives for a square; where that reaches beyond the area it is made anew.

        Args:
            centre_xy: (2,) world x, y near the map's centre [m].
            size_m: length of its sides [m].
        """
        whole, r = self._all, self._all.resolution_m
        count = round(size_m / r)
        first = np.round(np.asarray(centre_xy, dtype=float)[:2] / r - 0.5 * count)
        at = np.round(first - whole.lower_corner / r).astype(int)
        if (at < 0).any() or (at + count > whole.heights.shape).any():
            return elevation_map(self._world, centre_xy, size_m, r)
        heights = whole.heights[at[0] : at[0] + count, at[1] : at[1] + count].copy()
        return HeightMap(heights, r, (first + 0.5 * count) * r)


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
