"""Heights of the ground about feet, as the policies sample a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]

#: Rings about each foot: radii [m] and numbers of points, the first of each ahead.
_RINGS = ((0.1, 6), (0.3, 8), (0.5, 10), (0.7, 12), (0.9, 16))


def rings() -> Array:
    """(52, 2) places about a foot, x ahead, y to the left [m]."""
    return np.concatenate(
        [
            radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            for radius, number in _RINGS
            for angle in [2.0 * np.pi * np.arange(number) / number]
        ]
    )


def heights_at(elevation: HeightMap | None, places: Array, unknown: float) -> Array:
    """(...,) heights of the cells that hold places (..., 2), world frame [m]; ``unknown`` where nothing is known."""
    out = np.full(places.shape[:-1], unknown)
    if elevation is None:
        return out
    cells = np.floor((places - elevation.lower_corner) / elevation.resolution_m).astype(np.int64)
    inside = ((cells >= 0) & (cells < elevation.heights.shape)).all(axis=-1)
    found = elevation.heights[cells[inside, 0], cells[inside, 1]].astype(np.float64)
    out[inside] = np.where(np.isfinite(found), found, unknown)
    return out


def around_feet(elevation: HeightMap | None, soles: Array, yaw: float, unknown: float) -> Array:
    """(4, 52) heights [m] of the rings about feet (4, 3), world frame [m], turned by a heading [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    ring = rings() @ np.array([[c, s], [-s, c]])
    return heights_at(elevation, soles[:, None, :2] + ring, unknown)


def along_steps(elevation: HeightMap | None, soles: Array, ends: Array, number: int, unknown: float) -> Array:
    """(4, number) heights [m] on the straight lines from feet (4, 3) to their footholds (4, 2), world frame [m]."""
    share = np.linspace(0.0, 1.0, number)[None, :, None]
    places = soles[:, None, :2] + share * (ends - soles[:, :2])[:, None]
    return heights_at(elevation, places, unknown)
