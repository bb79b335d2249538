"""Who chooses the velocity command in closed loop: an operator without eyes on the feet, or the planner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool.sim.walks.walk import Walk
from legtool_runtime.motion.planning.pilot import Pilot
from legtool_runtime.motion.planning.plan import Goal
from legtool_runtime.motion.planning.planner import Planner
from legtool_runtime.rotations import rotation_of

Array = NDArray[np.float64]

#: The planner's goal lies beyond the finish, so that the robot walks over it instead of creeping up to it [m].
GOAL_BEYOND_M = 0.6


class BlindPilot:
    """Walks ahead at one speed: what an operator without eyes on the feet does."""

    def __init__(self, speed: float) -> None:
        self.speed = speed

    def command(self, walk: Walk) -> Array:
        """The same speed always."""
        return np.array([self.speed, 0.0, 0.0])


class PlannedPilot:
    """Hands the walk's state and map to the robot's own pilot at every full stance."""

    def __init__(self, planner: Planner, *, cruise_speed: float | None = None) -> None:
        self._pilot = Pilot(planner, cruise_speed=cruise_speed)

    def command(self, walk: Walk) -> Array:
        """What the pilot commands, to a goal beyond the finish.

        Raises:
            LegtoolError: at the start, what the planner could not plan from.
        """
        assert walk.costmap is not None
        state = walk.simulation.state
        command = self._pilot.command(
            walk.tracker.state(),
            walk.costmap,
            position=state.position_world,
            rotation=rotation_of(state.orientation),
            goal=Goal(walk.course.goal[0] + GOAL_BEYOND_M, walk.course.goal[1]),
            time_s=walk.simulation.time_s,
            steps=walk.tracker.steps,
        )
        walk.plan = self._pilot.plan
        assert walk.plan is not None
        walk.planning_times_s.append(walk.plan.planning_time_s)
        return command
