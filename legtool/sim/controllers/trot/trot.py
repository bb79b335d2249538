"""The built-in blind trotting controller: stance forces for a rigid body, Raibert footholds, swing by inverse dynamics.

It keeps no integrators, and takes up a command only at the end of full stance: what a step does is a nearly linear map
of the state at its beginning and the command held during it, which is what the motion models learn.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool.configs.controller import TrotSettings
from legtool.sim.controllers.trot.gait import (
    GRAVITY,
    MEMORY,
    MOTION,
    PARAMETERS,
    STANCE,
    STANDING,
    STEPPING,
    SWING,
    advance,
)
from legtool.sim.controllers.trot.observe import observe
from legtool.sim.controllers.trot.swing import place_foot, swing_torque
from legtool.sim.controllers.trot.trunk import stand_torques
from legtool.sim.robots.physics import CONTROL_RATE_HZ
from legtool.sim.robots.robot import SimRobot
from legtool.sim.robots.state import FORCES, JOINT_VELOCITIES, JOINTS, RobotState
from legtool_runtime.cache import kernel

Array = NDArray[np.float64]
Records = NDArray[Any]

#: The height of the robot the settings are written for [m].
REFERENCE_HEIGHT = 0.39
#: Dry friction and damping of the joints of robots the settings are written for, over weight × thigh length, at most.
REFERENCE_FRICTION, REFERENCE_DAMPING_S = 0.0065, 0.008
#: The same from which on a robot loses so much that the whole trim is needed.
LOSSY_FRICTION, LOSSY_DAMPING_S = 0.002, 0.003
#: The share of the trim that a robot without any needs.
LEAST_TRIM = 0.3
#: Compensation grows to dry friction over this rate, less where there is more friction, and at least over this, above
#: the noise of measured rates [rad/s].
FRICTION_RATE, LEAST_FRICTION_RATE = 0.5, 0.1
#: A sweep sends a new command this long before it is taken up: a few rows of a recording, little of a step [s].
SEND_AHEAD_S = 0.0125
_LENGTHS = ("swing_height", "search_depth", "foothold_reach")
_TIMES = ("swing_s", "full_stance_s", "stretch_s", "foothold_gain_s", "load_s")
_RATES = ("velocity_gain", "height_damping", "attitude_damping", "yaw_gain", "swing_damping")
_SQUARED_RATES = ("height_stiffness", "attitude_stiffness", "hold_stiffness", "swing_stiffness")


class TrotController:
    """A trot for any robot whose geometry and masses are known; a :class:`.Controller`."""

    def __init__(self, robot: SimRobot, settings: TrotSettings | None = None) -> None:
        self.parameters = parameters(robot, settings or TrotSettings())
        self.memory = np.zeros(1, MEMORY)
        self._motion = np.zeros(1, MOTION)
        self._torque = np.zeros(12)

    def reset(self, state: RobotState) -> None:
        """Forget the past; the robot stands on all four feet."""
        self.memory[:] = np.zeros(1, MEMORY)
        self.memory["load"] = 1.0
        self.memory["ground"] = state.position_world[2] - self.parameters["height"]
        self.memory["forces"][0, :, 2] = 0.25

    def step(self, state: RobotState, command: Array) -> Array:
        """Torques (12,) [Nm] for this tick; see :class:`~legtool.sim.controllers.controller.Controller`."""
        _tick(self.parameters, self.memory, self._motion, state.values, command, self._torque)
        return self._torque

    def accepts_command(self) -> bool:
        """Whether the robot stands, or full stance is about to end."""
        memory, p = self.memory[0], self.parameters[0]
        return bool(memory["mode"] == STANDING or memory["clock"] > p["swing_s"] + p["full_stance_s"] - SEND_AHEAD_S)

    @property
    def transition(self) -> bool:
        """Whether full stance ended at the last tick: the command was taken up and a pair of feet lifts off."""
        return bool(self.memory["transition"][0])

    @property
    def stepping(self) -> bool:
        """Whether the robot trots; else it stands."""
        return bool(self.memory["mode"][0] == STEPPING)

    @property
    def swing_pair(self) -> int:
        """Index into TROT_PAIRS of the pair that swings, or swung last."""
        return int(self.memory["pair"][0])

    @property
    def phase(self) -> float:
        """Time since the last lift-off, in shares of the undisturbed step; above 1 while full stance is stretched."""
        p = self.parameters[0]
        return float(self.memory["clock"][0] / (p["swing_s"] + p["full_stance_s"]))

    @property
    def stance_legs(self) -> NDArray[np.bool_]:
        """(4,) which legs the controller takes to stand."""
        return self.memory["leg"][0] == STANCE

    @property
    def command(self) -> Array:
        """(3,) the command held for this step."""
        return self.memory["command"][0].copy()


def parameters(robot: SimRobot, settings: TrotSettings) -> Records:
    """The controller's record for one robot: its masses, and the settings scaled to its height."""
    length = robot.geometry.standing_height / REFERENCE_HEIGHT
    time = np.sqrt(length)
    record = np.zeros(1, PARAMETERS)
    for name, value in settings.to_dict().items():
        record[name] = value
    for name in _LENGTHS:
        record[name] *= length
    for name in _TIMES:
        record[name] *= time
    for name in _RATES:
        record[name] /= time
    for name in _SQUARED_RATES:
        record[name] /= time**2
    record["search_speed"] *= length / time
    geometry = robot.geometry
    record["dt"] = 1.0 / CONTROL_RATE_HZ
    record["hips"] = geometry.hips
    record["chain"] = np.stack([geometry.abduction_offset, geometry.thigh_length, geometry.shank_length], axis=1)
    record["height"] = geometry.standing_height
    record["foot_radius"] = geometry.foot_radius
    for name in (
        "link_mass",
        "link_com",
        "link_inertia",
        "armature",
        "torque_limit",
        "mass",
        "trunk_mass",
        "trunk_com",
        "inertia",
    ):
        record[name] = getattr(robot, name)
    record["friction"] = robot.joint_friction
    # What is left of drag makes a robot slow: no more of it than at the robots that the settings were written for.
    weight = robot.mass * GRAVITY * geometry.thigh_length[:, None]
    dry = np.minimum(1.0, REFERENCE_FRICTION * weight / np.maximum(robot.joint_friction, 1e-9))
    viscous = np.minimum(1.0, REFERENCE_DAMPING_S * weight / np.maximum(robot.joint_damping, 1e-9))
    left = 1.0 - record["friction_compensation"]
    record["compensated"] = 1.0 - left * dry
    share = (1.0 - left * viscous) / np.maximum(record["compensated"], 1e-9)
    record["damping"] = robot.joint_damping * share
    record["friction_rate"] = np.maximum(FRICTION_RATE * dry, LEAST_FRICTION_RATE)
    # The trim makes up for losses at impacts and in joints: a robot whose file has no friction would be too fast.
    losses = robot.joint_friction / (LOSSY_FRICTION * weight) + robot.joint_damping / (LOSSY_DAMPING_S * weight)
    needed = LEAST_TRIM + (1.0 - LEAST_TRIM) * min(1.0, float(losses.mean()))
    record["velocity_trim"] = 1.0 + (record["velocity_trim"] - 1.0) * needed
    # Feet stand around the centre of mass, not around the trunk's origin.
    record["nominal"] = geometry.stance[:, :2] - geometry.stance[:, :2].mean(axis=0) + robot.com[:2]
    record["moment_arm"] = 0.25 * length
    record["contact_force"] = 0.05 * robot.mass * GRAVITY
    record["still_speed"] = 0.12 * length / time
    record["kicked_speed"] = 0.25 * length / time
    record["settled_reach"] = 0.08 * length
    return record


@kernel
def _tick(
    parameters: Records,
    memory: Records,
    motion: Records,
    values: Array,
    command: Array,
    torque: Array,
) -> None:
    p, m, x = parameters[0], memory[0], motion[0]
    angles = values[JOINTS:JOINT_VELOCITIES].reshape(4, 3)
    rates = values[JOINT_VELOCITIES:FORCES].reshape(4, 3)
    jacobians, inertias, torques = np.empty((4, 3, 3)), np.empty((4, 3, 3)), np.empty((4, 3))
    observe(p, m, x, values, angles, rates, jacobians, inertias, torques)
    advance(p, m, x, command)
    for leg in range(4):
        if m.leg[leg] == SWING:
            place_foot(p, m, x, leg)
    stand_torques(p, m, x, angles, rates, jacobians, torques)
    for leg in range(4):
        if m.leg[leg] != STANCE:
            swing_torque(p, m, x, leg, angles[leg], rates[leg], jacobians[leg], inertias[leg], torques[leg])
        for joint in range(3):
            limit = p.torque_limit[leg, joint]
            torque[3 * leg + joint] = min(limit, max(-limit, torques[leg, joint]))
