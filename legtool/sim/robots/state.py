"""What a robot measures of itself at one tick, and where each quantity stands."""

from __future__ import annotations

import numpy as np

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
