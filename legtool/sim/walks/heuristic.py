"""Gaits that step where a heuristic says, on the nearest admissible ground: S-MPC and EM-MPC of QuadPiPS (VIII-B)."""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from legtool.sim.walks.environment import GuidedGait, Observation
from legtool.sim.walks.mapping import Mapper
from legtool.sim.walks.operators import TowardsGoal
from legtool.sim.walks.planners import PlanHistory
from legtool.sim.walks.region_finder import RegionFinder
from legtool.sim.worlds.world import World
from legtool_runtime.robot import Robot
from legtool_runtime.rotations import rotation_of, yaw_of
from legtool_runtime.search.nearest_places import cell_places, region_places
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.terrain.settings import ElevationSettings
from legtool_runtime.tracking.gait_tracker import Guidance
from legtool_runtime.tracking.selectors import Selector, any_place

Array = NDArray[np.float64]

#: Ground of an elevation map: deviation from the plane of 3 × 3 cells [m], slope, and a border of one cell.
_ROUGHNESS_M, _STEEPEST = 0.02, math.tan(math.radians(30.0))


class HeuristicPlanner:
    """Nominal footholds of a trot towards the goal, each moved to the nearest admissible place.

    Attributes:
        history: times of finding what is admissible, frame by frame.
    """

    def __init__(
        self, world: World, robot: Robot, elevation: ElevationSettings, *, finder: RegionFinder | None = None
    ) -> None:
        """Begin a walk.

        Args:
            world: whose goal is walked to.
            robot: that walks.
            elevation: of the map that legs are kept off by.
            finder: of the regions that are admissible; None: flat cells of the map are.
        """
        self.history = PlanHistory()
        self._robot, self._finder, self._rule = robot, finder, TowardsGoal(world)
        self._mapper = Mapper(robot, elevation, for_feet=True)
        self._map: HeightMap | None = None
        self._select: Selector = any_place(None)

    def act(self, observation: Observation) -> GuidedGait:
        """Guidance for the gait, by what was seen last."""
        state = observation.state
        began = time.perf_counter()
        seen = self._mapper.see(observation)
        if seen is not None:
            self._map = seen
        if self._finder is not None:
            if (regions := self._finder.see(observation)) is not None:
                self._select = region_places(regions, self._robot)
        elif seen is not None:
            self._select = cell_places(seen, flat_cells(seen), self._robot)
        if seen is not None:
            self.history.planning_times_s.append(time.perf_counter() - began)
        command = self._rule.command(state.position_world, float(yaw_of(rotation_of(state.orientation))))
        return GuidedGait(Guidance(command, self._select, None, self._map, paced=False))


def flat_cells(elevation: HeightMap) -> NDArray[np.bool_]:
    """(n_x, n_y) cells of planar ground in an elevation map, less a border of one cell (QuadPiPS, section VIII-B2).

    As in the pipeline that the paper compares with: cells whose 3 × 3 heights lie within 2 cm of a plane, which is no
    steeper than 30°.
    """
    z = elevation.heights.astype(np.float64)
    kernel = np.array([-1.0, 0.0, 1.0])
    along_x = ndimage.correlate(z, np.outer(kernel, np.ones(3)), mode="constant", cval=np.nan) / 6
    along_y = ndimage.correlate(z, np.outer(np.ones(3), kernel), mode="constant", cval=np.nan) / 6
    mean = ndimage.correlate(z, np.full((3, 3), 1 / 9), mode="constant", cval=np.nan)
    worst = np.zeros_like(z)
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            there = ndimage.shift(z, (-i, -j), order=0, mode="constant", cval=np.nan)
            with np.errstate(invalid="ignore"):
                worst = np.maximum(worst, np.abs(there - mean - i * along_x - j * along_y))
    with np.errstate(invalid="ignore"):
        flat = (worst <= _ROUGHNESS_M) & (np.hypot(along_x, along_y) <= _STEEPEST * elevation.resolution_m)
    return ndimage.binary_erosion(flat, np.ones((3, 3), np.bool_))
