"""Walks by script: a contact plan made before the first step, and how near to it feet land."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from legtool.configs.courses import LEG_M, Course
from legtool.sim.controllers.tracked import GuidedController, TrackedController, standing_feet
from legtool.sim.walks.environment import Answer, Observation, PlannedContacts
from legtool.sim.walks.simulated import SimulatedRobot
from legtool.sim.worlds.world import World
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.gaits import GaitTiming, plan_from_gait
from legtool_runtime.tracking.model import TrackedRobot

Array = NDArray[np.float64]

#: The first foot lifts off after this [s].
_START_S = 0.3
#: Slopes are measured over this much to both sides of a foothold [m]; what is steeper is an edge, not a slope.
_AROUND_M, _STEEPEST = 0.005, 0.6


class ScriptedPlanner:
    """Answers with one contact plan: the footholds of a course, each a little out of its place, at the ground's height.

    Attributes:
        contacts: the plan; None before the first tick.
    """

    def __init__(self, course: Course, world: World, robot: TrackedRobot, rng: np.random.Generator) -> None:
        """Draw the footholds.

        Args:
            course: which foot goes where.
            world: in which it was laid.
            robot: that walks.
            rng: of the jitter.
        """
        self.contacts: ContactPlan | None = None
        self._course, self._world, self._robot = course, world, robot
        places = course.footholds(robot.geometry)
        most = np.array(course.jitter) * course.scale(robot.geometry)
        places[:, 1:] += rng.uniform(-most, most, places[:, 1:].shape)
        self._places = places

    def act(self, observation: Observation) -> Answer:
        """The plan, from where the robot stands at the first tick.

        Raises:
            TrackingError: a foothold is out of reach.
        """
        if self.contacts is None:
            self.contacts = self._plan(standing_feet(self._robot, observation.state))
        return PlannedContacts(self.contacts)

    def share(self, observation: Observation) -> float:
        """How much of the plan's time is over; NaN before there is a plan."""
        return np.nan if self.contacts is None else observation.time_s / self.contacts.end_s

    def _plan(self, feet: Array) -> ContactPlan:
        world = self._world
        x, y = self._places[..., 0], self._places[..., 1]
        places = np.stack([x, y, world.height(x, y)], axis=-1)
        places[:, 0] = feet
        slopes = [
            (world.height(x + dx, y + dy) - world.height(x - dx, y - dy)) / (2 * _AROUND_M)
            for dx, dy in ((_AROUND_M, 0.0), (0.0, _AROUND_M))
        ]
        normals = np.stack([*(np.where(np.abs(s) < _STEEPEST, -s, 0.0) for s in slopes), np.ones_like(x)], axis=-1)
        normals[:, 0] = (0.0, 0.0, 1.0)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        return plan_from_gait(
            timing(self._course, self._robot), list(places), start_s=_START_S, normals=list(normals),
            robot=self._robot.geometry,
        )  # fmt: skip


def timing(course: Course, robot: TrackedRobot) -> GaitTiming:
    """The course's gait; shorter legs step faster, by the root of their length."""
    gait = GaitTiming.trot() if course.gait == "trot" else GaitTiming.crawl()
    legs = robot.geometry.thigh_length + robot.geometry.shank_length
    factor = float(np.sqrt(legs.max() / LEG_M))
    return GaitTiming(gait.groups, factor * gait.swing_s, factor * gait.full_stance_s)


class Push:
    """Changes the robot's horizontal velocity once, some time in the middle of a walk; a :class:`.Subscriber`."""

    def __init__(
        self,
        environment: SimulatedRobot,
        share: Callable[[Observation], float],
        speed: float,
        rng: np.random.Generator,
    ) -> None:
        """Draw when, within the middle half of the walk, and from where.

        Args:
            environment: who is pushed.
            share: how much of the walk is over, 0 to 1; NaN while nobody knows.
            speed: by which the velocity changes [m/s].
            rng: of time and direction.
        """
        self._environment, self._share = environment, share
        self._when, angle = rng.uniform(0.25, 0.75), rng.uniform(-np.pi, np.pi)
        self._change = speed * np.array([np.cos(angle), np.sin(angle)])
        #: When the robot was pushed [s]; None before.
        self.pushed_s: float | None = None

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """Push when it is time."""
        del answer
        if self.pushed_s is None and self._share(observation) >= self._when:
            self._environment.simulation.push(self._change)
            self.pushed_s = observation.time_s

    def end(self) -> None:
        """Nothing to close."""


class Tracking:
    """Notes how near to their planned places feet truly land, and saturated torques; a :class:`.Subscriber`.

    Attributes:
        landings: when [s], which leg, and how far off its place in the horizontal [m].
        saturated: ticks at which a torque was at its limit, and all ticks.
    """

    def __init__(self, environment: SimulatedRobot, controller: TrackedController | GuidedController) -> None:
        self.landings: list[tuple[float, int, float]] = []
        self.saturated = [0, 0]
        self._environment, self._controller = environment, controller
        self._limit = 0.999 * environment.simulation.robot.torque_limit.ravel()

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """Look at the torques, and at the feet that have landed."""
        del answer
        torques = np.abs(self._environment.simulation.torque)
        self.saturated[0] += bool((torques >= self._limit).any())
        self.saturated[1] += 1
        tracker = self._controller.tracker
        if tracker is None or len(tracker.landings) == len(self.landings):
            return
        feet, _ = self._environment.feet()
        radius = self._controller.robot.geometry.foot_radius
        for landing in tracker.landings[len(self.landings) :]:
            # The contact point of a ball on a slope is not its lowest one.
            place = feet[landing.leg] + radius * (np.array([0.0, 0.0, 1.0]) - landing.normal)
            error = float(np.hypot(*(place - landing.planned)[:2]))
            self.landings.append((observation.time_s, landing.leg, error))

    def end(self) -> None:
        """Nothing to close."""
