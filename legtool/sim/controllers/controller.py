"""What every black-box controller looks like to the simulator: a measured state and a command in, joint torques out."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from legtool.sim.robots.state import RobotState
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.gait_tracker import Guidance

Array = NDArray[np.float64]

#: What a controller can take, and a planner answer with.
Orders = Literal["velocity commands", "contact plans", "guided gaits"]


class Controller(Protocol):
    """A controller that follows velocity commands. It is blind, unless it has a method ``see`` (:func:`show`)."""

    def reset(self, state: RobotState) -> None:
        """Forget the past and start from a robot standing at rest."""

    def step(self, state: RobotState, command: Array) -> Array:
        """Run one control tick.

        Args:
            state: what the robot measures now.
            command: (3,) vx, vy [m/s] and yaw rate [rad/s], base frame.

        Returns:
            (12,) joint torques [Nm], legs FL, FR, RL, RR × hip, thigh, knee. The array may be reused at the next tick.
        """

    def accepts_command(self) -> bool:
        """Whether a command sent now is taken up within a few ticks.

        A sweep changes its command only then, so that a step has one command and no recorded row is ambiguous about it.
        """


class ContactController(Protocol):
    """A controller that puts feet where a contact plan says."""

    takes: Literal["contact plans"]

    def reset(self, state: RobotState) -> None:
        """Forget the past and start from a robot standing at rest."""

    def step(self, state: RobotState, plan: ContactPlan) -> Array:
        """Run one control tick.

        Args:
            state: what the robot measures now.
            plan: to follow, on a clock that began at 0 with the first tick.

        Returns:
            (12,) joint torques [Nm], as those of :class:`Controller`.
        """

    def outcome(self) -> str:
        """``goal`` once the plan is walked to its end, ``stopped: ...`` where it cannot; empty while it goes on."""


class GaitController(Protocol):
    """A controller that walks a gait on footholds that it asks for."""

    takes: Literal["guided gaits"]

    def reset(self, state: RobotState) -> None:
        """Forget the past and start from a robot standing at rest."""

    def step(self, state: RobotState, guidance: Guidance) -> Array:
        """Run one control tick, see :class:`ContactController`; ``guidance`` counts from now on."""

    def outcome(self) -> str:
        """``stopped: ...`` where it cannot go on; else empty."""


AnyController = Controller | ContactController | GaitController


def takes(controller: AnyController) -> Orders:
    """What a controller takes; one that does not say takes velocity commands."""
    given: Orders = getattr(controller, "takes", "velocity commands")
    return given


def show(controller: AnyController, terrain: HeightMap | None) -> None:
    """Hand what a planner knows of the ground to a controller with a method ``see``; None: nothing is known."""
    see = getattr(controller, "see", None)
    if see is not None:
        see(terrain)
