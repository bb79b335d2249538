"""Gaits that step where a heuristic says, on the nearest admissible ground, and policies that are told the same: the
baselines of QuadPiPS (section VIII-B)."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from legtool.sim.walks.environment import GuidedGait, Observation
from legtool.sim.walks.flat_ground import flat_cells
from legtool.sim.walks.mapping import Mapper
from legtool.sim.walks.operators import Operator, TowardsGoal
from legtool.sim.walks.planners import PlanHistory
from legtool.sim.walks.region_finder import RegionFinder
from legtool.sim.walks.scene import Known
from legtool.sim.worlds.world import World
from legtool_runtime.robot import Robot
from legtool_runtime.rotations import rotation_of, yaw_of
from legtool_runtime.search.nearest_places import cell_places, region_places
from legtool_runtime.terrain.conditioning import fill_hidden
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.terrain.settings import ElevationSettings
from legtool_runtime.tracking.gait_tracker import Guidance
from legtool_runtime.tracking.selectors import Selector, any_place

Array = NDArray[np.float64]


class HeuristicPlanner:
    """Nominal footholds of a trot towards the goal, each moved to the nearest admissible place; and a map.

    Attributes:
        history: times of finding what is admissible, frame by frame.
    """

    def __init__(
        self, world: World, robot: Robot, elevation: ElevationSettings, *, finder: RegionFinder | None = None,
        operator: Operator | None = None, chooses: bool = True, hidden_m: float = 0.0,
    ) -> None:  # fmt: skip
        """Begin a walk.

        Args:
            world: whose goal is walked to.
            robot: that walks.
            elevation: of the map that legs are kept off by.
            finder: of the regions that are admissible; None: flat cells of the map are.
            operator: whose command is followed; None: that of the paper's baselines.
            chooses: whether footholds are moved at all, or every place is taken as it is.
            hidden_m: strips up to this wide that edges hide get the heights that the line of sight allows, for policies
                that ask for heights everywhere [m]; 0: as :class:`.Mapper` leaves them.
        """
        self.history = PlanHistory()
        self._robot, self._finder, self._chooses, self._hidden_m = robot, finder, chooses, hidden_m
        self._rule: Operator = operator or TowardsGoal(world)
        self._mapper = Mapper(robot, elevation, for_feet=True)
        self._map: HeightMap | None = None
        self._select: Selector = any_place(None)

    @property
    def known(self) -> Known:
        """Its map."""
        return Known(terrain=self._map)

    def act(self, observation: Observation) -> GuidedGait:
        """Guidance for the gait, by what was seen last."""
        state = observation.state
        began = time.perf_counter()
        seen = self._mapper.see(observation)
        if seen is not None and self._hidden_m > 0.0:
            seen = fill_hidden(seen, widest_m=self._hidden_m)
        if seen is not None:
            self._map = seen
        if self._finder is not None:
            if (regions := self._finder.see(observation)) is not None:
                self._select = region_places(regions, self._robot)
        elif seen is not None and self._chooses:
            self._select = cell_places(seen, flat_cells(seen), self._robot)
        if seen is not None:
            self.history.planning_times_s.append(time.perf_counter() - began)
        command = self._rule.command(state.position_world, float(yaw_of(rotation_of(state.orientation))))
        return GuidedGait(Guidance(command, self._select, None, self._map, paced=False))
