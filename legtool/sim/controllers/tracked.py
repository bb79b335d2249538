"""The tracking controller of the runtime, in simulation."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.sim.robots.robot import SimRobot
from legtool.sim.robots.state import RobotState
from legtool.sim.robots.tracked import tracked_robot
from legtool_runtime.rotations import rotation_of
from legtool_runtime.search.swings.settings import SwingSettings
from legtool_runtime.search.swings.walked_references import OptimisedReferences
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.gait_tracker import GaitTracker, Guidance
from legtool_runtime.tracking.gaits import GaitTiming
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.settings import TrackerSettings
from legtool_runtime.tracking.tracker import MeasuredState, Tracker
from legtool_runtime.tracking.warm_up import warm_up, warm_up_gait

Array = NDArray[np.float64]

#: So long after the plan's last event a robot that stands has walked it, and so long after a fault it is given up [s].
_SETTLED_S, _GIVEN_UP_S = 0.4, 1.5


class TrackedController:
    """Follows contact plans; a :class:`.ContactController`.

    Attributes:
        tracker: of the walk; None before the first tick.
        references: of optimised motions; None where the body follows the tracker's own.
    """

    takes: Literal["contact plans"] = "contact plans"

    def __init__(
        self, robot: SimRobot, settings: TrackerSettings | None = None, *, optimised: bool = False, window: int = 3
    ) -> None:
        """Take the robot, and what is known of its ground.

        Args:
            robot: that is controlled.
            settings: of tracking.
            optimised: the body follows optimised motions.
            window: transitions that these are optimised over at once.

        Raises:
            RobotError: a robot that cannot be controlled with, such as one without torque limits.
        """
        self.robot: TrackedRobot = tracked_robot(robot)
        chosen = SwingSettings(window=window)
        self.references = OptimisedReferences(self.robot, chosen) if optimised else None
        self.tracker: Tracker | None = None
        self._settings = settings
        self._plan: ContactPlan | None = None
        self._ticks = 0
        self._over_s = 0.0

    def warm_up(self) -> None:
        """Compile, or load, what the ticks call, so that the first of them takes no longer than the others."""
        warm_up(self.robot)
        if self.references is not None:
            self.references.optimiser.warm_up()

    def reset(self, state: RobotState) -> None:
        """Forget the past."""
        del state
        self.tracker, self._plan, self._ticks, self._over_s = None, None, 0, 0.0
        if self.references is not None:
            self.references.reset()

    def step(self, state: RobotState, plan: ContactPlan) -> Array:
        """Torques at one tick, see :class:`.ContactController`.

        Raises:
            TrackingError: the plan puts a foot out of reach.
        """
        if self.tracker is None:
            self.tracker = Tracker(self.robot, plan, settings=self._settings, references=self.references)
        elif plan is not self._plan:
            self.tracker.follow(plan)
        self._plan = plan
        torques = self.tracker.step(measured(state), self._ticks / CONTROL_RATE_HZ)
        self._ticks += 1
        if self.tracker.fault or self.tracker.finished:
            self._over_s += 1.0 / CONTROL_RATE_HZ
        return torques

    def outcome(self) -> str:
        """Whether the plan is walked, or cannot be."""
        if self.tracker is None:
            return ""
        if self.tracker.fault:
            return f"stopped: {self.tracker.fault}" if self._over_s > _GIVEN_UP_S else ""
        return "goal" if self._over_s > _SETTLED_S else ""


class GuidedController:
    """Walks a gait on footholds that it asks for; a :class:`.GaitController`.

    Attributes:
        robot: as the tracker knows it.
        gait: that is walked.
    """

    takes: Literal["guided gaits"] = "guided gaits"

    def __init__(self, robot: SimRobot, timing: GaitTiming, *, force_noise: float = 0.0) -> None:
        """Take the robot, its gait, and the errors of the forces on its feet, see :class:`.TrackerSettings`.

        Raises:
            RobotError: a robot that cannot be controlled with, such as one without torque limits.
        """
        self.robot: TrackedRobot = tracked_robot(robot)
        self._timing = timing
        self._settings = GaitTracker.settings_for(self.robot, force_noise=force_noise)
        self.gait = GaitTracker(self.robot, timing, settings=self._settings)
        self._ticks = 0
        self._over_s = 0.0

    def warm_up(self) -> None:
        """Compile, or load, what the ticks call, see :meth:`TrackedController.warm_up`."""
        warm_up_gait(self.robot)

    @property
    def tracker(self) -> Tracker | None:
        """That carries the gait out; None before the first tick."""
        return self.gait.tracker

    def reset(self, state: RobotState) -> None:
        """Forget the past."""
        del state
        self.gait = GaitTracker(self.robot, self._timing, settings=self._settings)
        self._ticks, self._over_s = 0, 0.0

    def step(self, state: RobotState, guidance: Guidance) -> Array:
        """Torques at one tick, see :class:`.GaitController`."""
        torques = self.gait.step(measured(state), self._ticks / CONTROL_RATE_HZ, guidance)
        self._ticks += 1
        if self.tracker is not None and self.tracker.fault:
            self._over_s += 1.0 / CONTROL_RATE_HZ
        return torques

    def outcome(self) -> str:
        """Why the walk cannot go on."""
        fault = "" if self.tracker is None else self.tracker.fault
        return f"stopped: {fault}" if fault and self._over_s > _GIVEN_UP_S else ""


def measured(state: RobotState) -> MeasuredState:
    """A simulated robot's measurement as the tracker takes it."""
    velocity = np.concatenate([state.velocity_world, state.angular_velocity_base, state.joint_velocities.ravel()])
    return MeasuredState(state.position_world, state.orientation, state.joint_positions, velocity, state.foot_forces)


def standing_feet(robot: TrackedRobot, state: RobotState) -> Array:
    """(4, 3) contact points of a robot that stands on level ground, world frame [m]."""
    feet = state.position_world + robot.geometry.feet(state.joint_positions) @ rotation_of(state.orientation).T
    feet[:, 2] -= robot.geometry.foot_radius
    return feet
