"""A planner of your own, in one file: a trot to the goal whose feet go to the highest ground near their nominal places.

    cd examples/planners
    legtool eval planner --suite ramp --planners high_ground:HighGround,em_mpc --robot anymal_c --trials 3 --out walks

A planner is made anew for each walk with a task (legtool.sim.walks.own.Task: the robot, the start, the places to pass),
and ``act`` is asked 400 times a second with what the robot knows (legtool.sim.walks.environment.Observation).
"""

import math

import numpy as np

from legtool.sim.walks.environment import GuidedGait, Observation
from legtool.sim.walks.mapping import Mapper
from legtool.sim.walks.own import Task
from legtool_runtime.rotations import rotation_of, yaw_of
from legtool_runtime.tracking.gait_tracker import Guidance
from legtool_runtime.tracking.selectors import Place, Wish, ground_normal

SPEED, TURN = 0.25, 0.25
#: Feet are moved by so much at most [m]; near the goal the robot stops.
NEAR_M, STOP_M = 0.08, 0.1


class HighGround:
    """Answers with a trot that asks for the place of each foot."""

    answers = "guided gaits"

    def __init__(self, task: Task) -> None:
        self.task = task
        self.mapper = Mapper(task.robot, task.elevation, for_feet=True)  # from depth images, or the true heights
        self.elevation = None
        self.next = 0

    def act(self, observation: Observation) -> GuidedGait:
        """A command to the next place, and the footholds."""
        seen = self.mapper.see(observation)
        if seen is not None:
            self.elevation = seen
        return GuidedGait(Guidance(self.command(observation), self.place, None, self.elevation))

    def command(self, observation: Observation) -> tuple[float, float, float]:
        """Forward, left [m/s] and yaw rate [rad/s]."""
        way = self.task.places[self.next] - observation.state.position_world[:2]
        if math.hypot(*way) < STOP_M:
            if self.next + 1 == len(self.task.places):
                return 0.0, 0.0, 0.0
            self.next += 1
        yaw = float(yaw_of(rotation_of(observation.state.orientation)))
        off = math.remainder(math.atan2(way[1], way[0]) - yaw, math.tau)
        return SPEED * math.cos(off), SPEED * math.sin(off), TURN * off

    def place(self, wish: Wish) -> Place | None:
        """The highest cell near a nominal foothold, and of cells that are alike the nearest; None: nothing is known."""
        if self.elevation is None:
            return Place(np.array([*wish.nominal, 0.0]), np.array([0.0, 0.0, 1.0]))
        points = self.elevation.points(wish.nominal, within_m=NEAR_M).astype(float)
        if not len(points):
            return None
        away = np.hypot(*(points[:, :2] - wish.nominal).T)
        best = points[np.argmin(away - 2.0 * points[:, 2])]
        return Place(best, ground_normal(self.elevation, *best[:2]))
