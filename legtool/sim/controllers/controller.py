"""What every black-box controller looks like to the simulator: a measured state and a command in, joint torques out."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from legtool.sim.robots.state import RobotState
from legtool_runtime.tracking.contact_plan import ContactPlan

Array = NDArray[np.float64]


class Controller(Protocol):
    """A blind controller that follows velocity commands. It sees no terrain."""

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
