"""A planner of the user's own in the closed loop: what it is told before a walk, and what it has to say."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from legtool.errors import SettingsError
from legtool.sim.controllers.blackbox import make_named
from legtool.sim.controllers.controller import Orders
from legtool.sim.controllers.tracked import TrackedController
from legtool.sim.robots.robot import SimRobot
from legtool.sim.robots.tracked import tracked_robot
from legtool.sim.walks.environment import Answer, Observation
from legtool.sim.walks.planners import PlanHistory
from legtool.sim.worlds.world import World
from legtool_runtime.robot import Robot
from legtool_runtime.terrain.settings import ElevationSettings
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.tracker import Tracker

Array = NDArray[np.float64]


@dataclass(eq=False)
class Task:
    """What a planner is told before a walk. Of the world it learns the rest by what it observes.

    Attributes:
        robot: geometry and leg kinematics.
        tracked: masses and limits besides, for plans of contacts.
        start: (3,) x, y [m], yaw [rad] of the world's start; the robot begins near it.
        places: (n, 2) to pass, the goal last [m].
        goal_radius_m: the goal is reached this near to it; None: at the line through it, across the way.
        elevation: settings of maps, as other planners use them (:class:`legtool.sim.walks.mapping.Mapper`).
    """

    robot: Robot
    tracked: TrackedRobot
    start: Array
    places: Array
    goal_radius_m: float | None
    elevation: ElevationSettings
    _controller: TrackedController | None = field(default=None, init=False)

    @property
    def tracker(self) -> Tracker | None:
        """That walks a planner's contact plans: its plan and its clock; None before the first tick."""
        return None if self._controller is None else self._controller.tracker

    def follow(self, controller: TrackedController) -> None:
        """Tell which controller walks the plans."""
        self._controller = controller


class PlannerOfTheUser(Protocol):
    """What ``--planners module:Class`` names: called with a :class:`Task` for each walk, and asked at every tick.

    Attributes:
        answers: what it answers with, which decides who walks it: ``velocity commands`` (the built-in trot, or the
            suite's black box), ``guided gaits`` (a trot that asks for the place of each foot), or ``contact plans``
            (the tracking controller). Left out: velocity commands.
        regions: whether images come with the labels of their pixels, or, with ``--set regions=truth``, the true regions
            in their place; the goal then counts when all feet stand. Left out: no.
    """

    answers: Orders
    regions: bool

    def act(self, observation: Observation) -> Answer:
        """The answer from now on: a VelocityCommand, GuidedGait or PlannedContacts of
        :mod:`legtool.sim.walks.environment`."""


class OwnPlanner:
    """A planner of the user's, whose time is taken wherever there was something new to see.

    Attributes:
        answers: what it answers with.
        wants_regions: whether it is given labels or regions.
        task: what it was told.
        history: times of its answers to new images or maps.
    """

    def __init__(self, where: str, robot: SimRobot, world: World, elevation: ElevationSettings) -> None:
        """Make one.

        Args:
            where: ``module:Class``.
            robot: that walks.
            world: where.
            elevation: of maps.

        Raises:
            SettingsError: nothing of that name, or something that is no planner.
        """
        self.task = Task(
            robot.geometry, tracked_robot(robot), world.start.copy(), world.points(), world.goal_radius_m, elevation
        )
        self._planner = make_named(
            "planner", where, self.task, needs=("act",), made_from="a task",
            protocol="legtool.sim.walks.own.PlannerOfTheUser",
        )  # fmt: skip
        self.answers = getattr(self._planner, "answers", "velocity commands")
        if self.answers not in get_args(Orders):
            raise SettingsError(
                f"planner {where!r}: answers is {self.answers!r}, expected one of {', '.join(get_args(Orders))}"
            )
        self.wants_regions = bool(getattr(self._planner, "regions", False))
        self.history = PlanHistory()

    def act(self, observation: Observation) -> Answer:
        """Its answer."""
        new = any(one is not None for one in (observation.image, observation.terrain, observation.regions))
        began = time.perf_counter()
        answer: Answer = self._planner.act(observation)
        if new:
            self.history.planning_times_s.append(time.perf_counter() - began)
        return answer
