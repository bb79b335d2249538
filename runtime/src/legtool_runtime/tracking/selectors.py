"""What finds a place for a foot near to a wanted one: any ground, or what the foothold criteria say is safe."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.errors import MapError, StateError
from legtool_runtime.foothold.gait import Gait
from legtool_runtime.foothold.heightmap import extract_heightmap
from legtool_runtime.foothold.selection import FootholdSelector
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE
from legtool_runtime.foothold.tuples import Tuple
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.ground import ground_of, height_at

Array = NDArray[np.float64]

#: Distances to the side count so much more: they cost a walking robot its balance.
SIDEWAYS = 2.5


class Wish(NamedTuple):
    """What a selector is asked for.

    ``leg``; ``nominal`` (2,) place wanted, world frame [m]; ``yaw`` at touchdown [rad]; ``hip`` (3,) of the leg at
    touchdown, world frame [m]; ``twist`` (6,) in the horizontal frame [m/s, rad/s]; ``gait``; ``most_sideways_m``;
    ``roll``, ``pitch`` of the trunk at touchdown [rad].
    """

    leg: int
    nominal: Array
    yaw: float
    hip: Array
    twist: tuple[float, ...]
    gait: Gait
    most_sideways_m: float
    roll: float = 0.0
    pitch: float = 0.0


class Place(NamedTuple):
    """A contact point (3,) and the ground's normal (3,) there, world frame [m]."""

    point: Array
    normal: Array


Selector = Callable[[Wish], Place | None]


def any_place(elevation: HeightMap | None) -> Selector:
    """A selector that takes every nominal place, at the map's height (0 where unknown, or without a map)."""

    def select(wish: Wish) -> Place | None:
        return place_at(elevation, float(wish.nominal[0]), float(wish.nominal[1]))

    return select


def place_at(elevation: HeightMap | None, x: float, y: float) -> Place:
    """The ground at a place [m]: at height 0 and level where it is not known."""
    height = height_at(ground_of(elevation), x, y)
    return Place(np.array([x, y, height if math.isfinite(height) else 0.0]), ground_normal(elevation, x, y))


def safe_places(selector: FootholdSelector, elevation: HeightMap) -> Selector:
    """A selector by the foothold criteria (ViTAL): the safe cell nearest to the nominal one, the way aside weighted.

    Legs are judged below the trunk as it is planned at touchdown, roll and pitch included.
    """

    def select(wish: Wish) -> Place | None:
        below = turned(wish.nominal - wish.hip[:2], -wish.yaw)
        try:
            heights = extract_heightmap(elevation, wish.nominal, yaw=wish.yaw, resample=True, outside=True)
            judged = Tuple(
                heights, leg=wish.leg, hip_height=float(wish.hip[2]), base_twist=wish.twist, gait=wish.gait,
                nominal=(float(below[0]), float(below[1])), roll=wish.roll, pitch=wish.pitch,
            )  # fmt: skip
            found = selector.select(judged, sideways=SIDEWAYS, most_sideways_m=wish.most_sideways_m)
        except (MapError, StateError):  # a robot that stumbles may ask for anything: there is no safe place then
            return None
        if found.cell is None:
            return None
        ix, iy = found.cell
        way = ((ix - SIZE // 2) * RESOLUTION_M, (iy - SIZE // 2) * RESOLUTION_M)
        x, y = (float(value) for value in wish.nominal + turned(way, wish.yaw))
        return Place(np.array([x, y, float(heights[ix, iy])]), ground_normal(elevation, x, y))

    return select


def ground_normal(elevation: HeightMap | None, x: float, y: float) -> Array:
    """(3,) normal of the plane through the map's cells around a place; straight up beside edges and unknown cells."""
    up = np.array([0.0, 0.0, 1.0])
    if elevation is None:
        return up
    cell = elevation.resolution_m
    i, j = (np.floor((np.array([x, y]) - elevation.lower_corner) / cell)).astype(int)
    if not (1 <= i < elevation.heights.shape[0] - 1 and 1 <= j < elevation.heights.shape[1] - 1):
        return up
    z = elevation.heights[i - 1 : i + 2, j - 1 : j + 2].astype(np.float64)
    slope_x, slope_y = (z[2] - z[0]).mean() / (2 * cell), (z[:, 2] - z[:, 0]).mean() / (2 * cell)
    i3 = np.arange(-1, 2) * cell
    off = z - z.mean() - slope_x * i3[:, None] - slope_y * i3[None, :]
    if not np.isfinite(off).all() or np.abs(off).max() > 0.01 or math.hypot(slope_x, slope_y) > 1.0:
        return up
    normal = np.array([-slope_x, -slope_y, 1.0])
    return normal / float(np.linalg.norm(normal))


def turned(way: ArrayLike, yaw: float) -> Array:
    """(2,) a horizontal vector turned by a heading."""
    x, y = (float(value) for value in np.asarray(way, dtype=np.float64))
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([c * x - s * y, s * x + c * y])
