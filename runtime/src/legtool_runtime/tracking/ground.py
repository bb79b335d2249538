"""An elevation map for compiled code: how high the ground is at a place, below a disc and below a ball."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.terrain.elevation import HeightMap

Array32 = NDArray[np.float32]


class Ground(NamedTuple):
    """Heights (n_x, n_y) [m], NaN where unknown; cell's side [m]; lower corner of the map, world frame [m]."""

    heights: Array32
    cell: float
    low_x: float
    low_y: float


def ground_of(elevation: HeightMap | None) -> Ground:
    """A map as compiled code reads it; None: nothing is known anywhere."""
    if elevation is None:
        return Ground(np.full((1, 1), np.nan, np.float32), 1.0, 0.0, 0.0)
    low = elevation.lower_corner
    return Ground(elevation.heights, float(elevation.resolution_m), float(low[0]), float(low[1]))


@kernel
def height_at(ground: Ground, x: float, y: float) -> float:
    """Height of the cell at a place [m]; NaN where unknown or off the map."""
    i = int(np.floor((x - ground.low_x) / ground.cell))
    j = int(np.floor((y - ground.low_y) / ground.cell))
    if 0 <= i < ground.heights.shape[0] and 0 <= j < ground.heights.shape[1]:
        return float(ground.heights[i, j])
    return np.nan


@kernel
def lowest_centre(ground: Ground, x: float, y: float, radius: float, around: bool, least: float = -np.inf) -> float:
    """How low the centre of a ball (of a flat disc unless ``around``) may be at a place [m], at least ``least``: -inf
    over unknown ground.

    Cells are columns; those that the ball does not reach sideways do not count.
    """
    cell = ground.cell
    first_i = int(np.floor((x - radius - ground.low_x) / cell))
    last_i = int(np.floor((x + radius - ground.low_x) / cell))
    first_j = int(np.floor((y - radius - ground.low_y) / cell))
    last_j = int(np.floor((y + radius - ground.low_y) / cell))
    best, beyond = least, radius if around else 0.0
    for i in range(max(first_i, 0), min(last_i, ground.heights.shape[0] - 1) + 1):
        left = ground.low_x + i * cell
        dx = max(left - x, 0.0, x - left - cell)
        for j in range(max(first_j, 0), min(last_j, ground.heights.shape[1] - 1) + 1):
            top = float(ground.heights[i, j])
            if not top + beyond > best:  # also NaN
                continue
            below = ground.low_y + j * cell
            dy = max(below - y, 0.0, y - below - cell)
            off = radius * radius - dx * dx - dy * dy
            if off >= 0.0:
                if around:
                    top += np.sqrt(off)
                best = max(best, top)
    return best
