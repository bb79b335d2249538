"""What every black-box controller looks like to the simulator: a measured state and a command in, joint torques out."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from legtool.sim.robots.state import RobotState

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
