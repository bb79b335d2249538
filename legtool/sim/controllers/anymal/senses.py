"""What both public ANYmal policies share: the robot as they were trained to feel it, and the drives that obey them.

Source: the public deployment and training code (lnotspotl/tbai_ros, lnotspotl/tbai_isaac), and what had to be set so
that the policies walk in MuJoCo. Joints are those of ANYmal C's URDF, legs in the order LF, LH, RF, RH.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.errors import SettingsError
from legtool.sim.robots.robot import SimRobot
from legtool.sim.robots.state import RobotState
from legtool_runtime.rotations import rotation_of

Array = NDArray[np.float64]

#: Our legs FL, FR, RL, RR in the policies' order LF, LH, RF, RH; it is its own inverse.
LEGS = [0, 2, 1, 3]
#: Joint angles that the zero action means [rad], in the policies' order.
HOME = np.array([0.0, 0.4, -0.8, 0.0, -0.4, 0.8, 0.0, 0.4, -0.8, 0.0, -0.4, 0.8])
#: A policy answers so often [Hz], which is so many control ticks.
RATE_HZ = 50
TICKS = round(CONTROL_RATE_HZ / RATE_HZ)
#: What a knee is by our chain, from thigh to knee to the middle of the foot's ball, less what it is in the URDF [rad];
#: legs FL, FR, RL, RR. All other joints are alike.
_KNEES = math.atan2(0.08795, 0.31547) * np.array([-1.0, -1.0, 1.0, 1.0])
#: Drives: stiffness [Nm/rad], damping [Nm s/rad], largest torque [Nm].
STIFFNESS, DAMPING, MOST_NM = 80.0, 2.0, 80.0
#: Radians of a joint for a unit of action.
ACTION_SCALE = 0.5
#: Scales of what is observed: base velocity, angular velocity, joint velocities; command (vx, vy, yaw rate).
VELOCITY, RATE, SPEEDS = 2.0, 0.25, 0.05
COMMAND = np.array([2.0, 2.0, 0.25])
#: Joints may differ from the lengths that policies were trained on by this [m].
_ANOTHER_ROBOT_M = 0.03
_THIGH_M, _ABDUCTION_M = 0.285, 0.1972


class Senses(NamedTuple):
    """What a policy feels.

    ``position`` (3,) of the base and ``rotation`` (3, 3) to the world; ``gravity``, ``velocity`` and ``rate`` (3,) in
    the base frame [-, m/s, rad/s]; ``joints`` and ``speeds`` (12,) of the URDF in the policies' order [rad, rad/s];
    ``soles`` (4, 3) lowest points of the feet, world frame, legs FL, FR, RL, RR [m].
    """

    position: Array
    rotation: Array
    gravity: Array
    velocity: Array
    rate: Array
    joints: Array
    speeds: Array
    soles: Array


class Drives:
    """Joint drives that hold a target of the policies at every control tick."""

    def __init__(self, robot: SimRobot) -> None:
        """Take the robot.

        Raises:
            SettingsError: its legs are not ANYmal's.
        """
        geometry = robot.geometry
        off = max(
            float(np.abs(geometry.thigh_length - _THIGH_M).max()),
            float(np.abs(np.abs(geometry.abduction_offset) - _ABDUCTION_M).max()),
        )
        if off > _ANOTHER_ROBOT_M:
            raise SettingsError(
                f"robot {geometry.name}: the policies em_rl and em_dtc are ANYmal's; choose --robot anymal_c or leave "
                "them out"
            )
        self._robot = geometry
        self._torque = np.zeros(12)

    def feel(self, state: RobotState) -> Senses:
        """A measured state as a policy feels it."""
        rotation, position = rotation_of(state.orientation), state.position_world.copy()
        soles = position + self._robot.feet(state.joint_positions) @ rotation.T
        soles[:, 2] -= self._robot.foot_radius
        return Senses(
            position, rotation, -rotation[2], rotation.T @ state.velocity_world, state.angular_velocity_base.copy(),
            self.of_policy(state.joint_positions), state.joint_velocities[LEGS].ravel(), soles,
        )  # fmt: skip

    def of_policy(self, angles: Array) -> Array:
        """(12,) joints of the URDF in the policies' order, for (4, 3) ours [rad]."""
        angles = angles.copy()
        angles[:, 2] -= _KNEES
        return angles[LEGS].ravel()

    def torques(self, state: RobotState, target: Array) -> Array:
        """(12,) joint torques [Nm] that drive the robot towards a target (12,) of a policy [rad]."""
        wanted = target.reshape(4, 3)[LEGS]
        wanted[:, 2] += _KNEES
        pulled = STIFFNESS * (wanted - state.joint_positions) - DAMPING * state.joint_velocities
        np.clip(pulled.ravel(), -MOST_NM, MOST_NM, out=self._torque)
        return self._torque


def load_network(path: Path | None, row: str, *, inputs: int) -> Any:
    """A policy in TorchScript, on one thread of the processor.

    Args:
        path: its file.
        row: whose policy it is, for messages.
        inputs: numbers that it takes.

    Raises:
        SettingsError: no file is named, or it is not there, is no TorchScript, or takes something else.
    """
    import torch  # only these two rows need it

    if path is None or not path.is_file():
        named = f"policies.{row} is missing" if path is None else f"{path}: no such file"
        raise SettingsError(f"{named}; set policies.{row} to the policy's TorchScript file (docs/arena.md says which)")
    torch.set_num_threads(1)
    try:
        network = torch.jit.load(str(path), map_location="cpu").eval()
        if hasattr(network, "set_hidden_size"):
            network.set_hidden_size()
        with torch.inference_mode():
            network(torch.zeros(1, inputs))
    except Exception as error:  # torch raises many kinds
        reason = str(error).strip().splitlines()[-1]
        raise SettingsError(f"{path}: no TorchScript policy with {inputs} inputs ({reason})") from error
    return network


def ask(network: Any, observation: Array) -> Array:
    """What a network answers to an observation (n,), flat."""
    import torch  # see load_network

    with torch.inference_mode():
        given = torch.from_numpy(observation.astype(np.float32))[None]
        return np.asarray(network(given).numpy(), dtype=np.float64).ravel()
