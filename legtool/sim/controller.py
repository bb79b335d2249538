"""What every black-box controller looks like to the simulator: a measured state and a command in, joint torques out."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Where each quantity stands in :attr:`RobotState.values`.
POSITION, ORIENTATION, VELOCITY, RATE, JOINTS, JOINT_VELOCITIES, FORCES = 0, 3, 7, 10, 13, 25, 37
STATE_SIZE = 41


class RobotState:
    """What a robot measures at one tick. The arrays are views into ``values``, overwritten at every tick.

    Attributes:
        position_world: (3,) base [m].
        orientation: (4,) base to world quaternion w, x, y, z.
        velocity_world: (3,) base [m/s].
        angular_velocity_base: (3,) [rad/s].
        joint_positions: (4, 3) [rad].
        joint_velocities: (4, 3) [rad/s].
        foot_forces: (4,) normal force of each foot [N].
    """

    def __init__(self) -> None:
        self.values = np.zeros(STATE_SIZE)
        self.position_world = self.values[POSITION:ORIENTATION]
        self.orientation = self.values[ORIENTATION:VELOCITY]
        self.velocity_world = self.values[VELOCITY:RATE]
        self.angular_velocity_base = self.values[RATE:JOINTS]
        self.joint_positions = self.values[JOINTS:JOINT_VELOCITIES].reshape(4, 3)
        self.joint_velocities = self.values[JOINT_VELOCITIES:FORCES].reshape(4, 3)
        self.foot_forces = self.values[FORCES:]


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
