"""The admissible place nearest to where a gait would step: how a controller steps on regions where nothing searches.

The rule is the public one of OCS2's perceptive controller, by which S-MPC and EM-MPC of QuadPiPS step (sections
VIII-B2, B5): least is squared distance to the nominal foothold + 5 · (squared over-extension of the leg + squared step
inwards of the hip), the former at touchdown and at lift-off.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.perception.regions import Regions
from legtool_runtime.robot import Robot
from legtool_runtime.search.settings import size_of
from legtool_runtime.search.surface import Outlines, outlines_of
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.selectors import Place, Selector, Wish, ground_normal, turned

Doubles = NDArray[np.float64]

#: Length of ANYmal's leg from where on it counts as over-extended [m], and what its and inward steps' squares weigh.
_EXTENDED_M, _WEIGHT = 0.55, 5.0
#: Places farther from the nominal one are not looked at (ANYmal C) [m].
_FARTHEST_M = 0.5
#: Passes over a region's sides after which the nearest place inside counts as found, and how near that is [m].
_PASSES, _EXACT_M = 20, 1e-4


def region_places(regions: Regions, robot: Robot, *, margin_m: float = 0.02) -> Selector:
    """A selector of places in planar regions.

    Args:
        regions: world frame.
        robot: whose legs step.
        margin_m: kept from a region's boundary; smaller regions are left out.

    Raises:
        PlannerError: a region whose boundary is not convex and counter-clockwise.
    """
    outlines, sizes = outlines_of(regions), _sizes(robot)

    def select(wish: Wish) -> Place | None:
        point, normal = np.empty(3), np.empty(3)
        found = _nearest_in_regions(outlines, _asked(wish), sizes, margin_m, point, normal)
        return Place(point, normal) if found else None

    return select


def cell_places(elevation: HeightMap, allowed: NDArray[np.bool_], robot: Robot) -> Selector:
    """A selector of cells of an elevation map.

    Args:
        elevation: the map.
        allowed: (n_x, n_y) cells that a foot may be set on.
        robot: whose legs step.
    """
    sizes, low = _sizes(robot), elevation.lower_corner

    def select(wish: Wish) -> Place | None:
        point = np.empty(3)
        cell = float(elevation.resolution_m)
        if not _nearest_of_cells(elevation.heights, allowed, low, cell, _asked(wish), sizes, point):
            return None
        return Place(point, ground_normal(elevation, float(point[0]), float(point[1])))

    return select


def _sizes(robot: Robot) -> Doubles:
    """(2,) lengths of the rule for a robot [m]."""
    return size_of(robot) * np.array([_EXTENDED_M, _FARTHEST_M])


def _asked(wish: Wish) -> Doubles:
    """(9,) nominal place, hip at touchdown, hip's way until lift-off, and the unit vector outwards (x, y)."""
    stance_s = wish.gait.duty_factor / wish.gait.step_frequency_hz
    way = turned(wish.twist[:2], wish.yaw) * stance_s
    side = 1.0 if wish.leg in (0, 2) else -1.0
    outwards = (-side * math.sin(wish.yaw), side * math.cos(wish.yaw))
    return np.array([*wish.nominal, *wish.hip, *way, *outwards])


@kernel
def _cost(asked: Doubles, sizes: Doubles, x: float, y: float, z: float) -> float:
    """What a place costs, infinite where no leg steps."""
    off = (x - asked[0]) ** 2 + (y - asked[1]) ** 2
    if off > sizes[1] ** 2:
        return np.inf
    extended = 0.0
    for end in range(2):
        dx, dy, dz = x - asked[2] - end * asked[5], y - asked[3] - end * asked[6], z - asked[4]
        extended = max(extended, np.sqrt(dx * dx + dy * dy + dz * dz) - sizes[0])
    inwards = max(-((x - asked[2]) * asked[7] + (y - asked[3]) * asked[8]), 0.0)
    return off + _WEIGHT * (max(extended, 0.0) ** 2 + inwards * inwards)


@kernel
def _nearest_in_regions(
    outlines: Outlines, asked: Doubles, sizes: Doubles, margin: float, point: Doubles, normal: Doubles
) -> bool:
    """Write the best place of all regions; whether there is one."""
    best, place = np.inf, np.empty(2)
    for r in range(outlines.start.shape[0] - 1):
        plane = outlines.poses[r]
        if plane[2, 2] < 0.5:
            continue
        z = (
            plane[2, 3]
            - (plane[0, 2] * (asked[0] - plane[0, 3]) + plane[1, 2] * (asked[1] - plane[1, 3])) / plane[2, 2]
        )
        for i in range(2):
            place[i] = 0.0
            for j in range(3):
                at = z if j == 2 else asked[j]
                place[i] += plane[j, i] * (at - plane[j, 3])
        if not _into(outlines, r, margin, place):
            continue
        x = plane[0, 3] + plane[0, 0] * place[0] + plane[0, 1] * place[1]
        y = plane[1, 3] + plane[1, 0] * place[0] + plane[1, 1] * place[1]
        z = plane[2, 3] + plane[2, 0] * place[0] + plane[2, 1] * place[1]
        cost = _cost(asked, sizes, x, y, z)
        if cost < best:
            best = cost
            point[0], point[1], point[2] = x, y, z
            normal[:] = plane[:3, 2]
    return best < np.inf


@kernel
def _into(outlines: Outlines, r: int, margin: float, place: Doubles) -> bool:
    """Move a place (2,) of a region's plane to the nearest one inside by a margin (Dykstra's projections); whether
    there is one."""
    first, last = outlines.start[r], outlines.start[r + 1]
    many = last - first
    carried = np.zeros((many, 2))
    for _ in range(_PASSES):
        moved = 0.0
        for k in range(many):
            a, b = outlines.corners[first + k], outlines.corners[first + (k + 1) % many]
            ex, ey = b[0] - a[0], b[1] - a[1]
            length = np.hypot(ex, ey)
            if length < 1e-9:
                continue
            px, py = place[0] + carried[k, 0], place[1] + carried[k, 1]
            inside = (ex * (py - a[1]) - ey * (px - a[0])) / length - margin
            lack = max(-inside, 0.0)
            x, y = px - ey / length * lack, py + ex / length * lack
            moved = max(moved, abs(x - place[0]) + abs(y - place[1]))
            carried[k, 0], carried[k, 1] = px - x, py - y
            place[0], place[1] = x, y
        if moved < _EXACT_M:
            break
    for k in range(many):
        a, b = outlines.corners[first + k], outlines.corners[first + (k + 1) % many]
        ex, ey = b[0] - a[0], b[1] - a[1]
        if ex * (place[1] - a[1]) - ey * (place[0] - a[0]) < (margin - 10.0 * _EXACT_M) * np.hypot(ex, ey):
            return False
    return True


@kernel
def _nearest_of_cells(
    heights: NDArray[np.float32], allowed: NDArray[np.bool_], low: Doubles, cell: float, asked: Doubles,
    sizes: Doubles, point: Doubles,
) -> bool:  # fmt: skip
    """Write the best of the allowed cells; whether there is one. The cell that holds the nominal place is stepped on
    there."""
    best, reach = np.inf, int(np.ceil(sizes[1] / cell))
    here_i, here_j = int(np.floor((asked[0] - low[0]) / cell)), int(np.floor((asked[1] - low[1]) / cell))
    for i in range(max(here_i - reach, 0), min(here_i + reach + 1, heights.shape[0])):
        for j in range(max(here_j - reach, 0), min(here_j + reach + 1, heights.shape[1])):
            if not allowed[i, j]:
                continue
            x, y = low[0] + (i + 0.5) * cell, low[1] + (j + 0.5) * cell
            if i == here_i and j == here_j:
                x, y = asked[0], asked[1]
            cost = _cost(asked, sizes, x, y, float(heights[i, j]))
            if cost < best:
                best = cost
                point[0], point[1], point[2] = x, y, heights[i, j]
    return best < np.inf
