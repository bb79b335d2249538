"""The built-in blind trotting controller: stance forces for a single rigid body, Raibert footholds, swing legs by inverse dynamics.

It keeps no integrators, and takes up a command only at the end of full stance: what a step does is a nearly linear map
of the state at its beginning and the command held during it, which is what the motion models learn.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from legtool.configs.controller import TrotSettings
from legtool.sim.controller import FORCES, JOINT_VELOCITIES, JOINTS, ORIENTATION, RATE, VELOCITY, RobotState
from legtool.sim.gait import GRAVITY, MEMORY, MOTION, PARAMETERS, STANCE, STANDING, STEPPING, SWING, advance
from legtool.sim.leg import leg_terms
from legtool.sim.robot import SimRobot
from legtool.sim.stance import stance_forces
from legtool.sim.swing import place_foot, swing_torque
from legtool.sim.world import CONTROL_RATE_HZ
from legtool_runtime.robot import leg_forward, leg_jacobian

Array = NDArray[np.float64]

#: The height of the robot the settings are written for [m].
REFERENCE_HEIGHT = 0.39
#: A sweep sends a new command this long before it is taken up: a few rows of a recording, little of a step [s].
SEND_AHEAD_S = 0.0125
_LENGTHS = ("swing_height", "search_depth", "foothold_reach")
_TIMES = ("swing_s", "full_stance_s", "stretch_s", "foothold_gain_s", "load_s")
_RATES = ("velocity_gain", "height_damping", "attitude_damping", "yaw_gain", "swing_damping")
_SQUARED_RATES = ("height_stiffness", "attitude_stiffness", "hold_stiffness", "swing_stiffness")


class TrotController:
    """A trot for any robot whose geometry and masses are known. It satisfies :class:`~legtool.sim.controller.Controller`."""

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
        """Torques (12,) [Nm] for this tick; see :class:`~legtool.sim.controller.Controller`."""
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


def parameters(robot: SimRobot, settings: TrotSettings) -> NDArray[np.void]:
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
    record["damping"] = robot.joint_damping
    # Feet stand around the centre of mass, not around the trunk's origin.
    record["nominal"] = geometry.stance[:, :2] - geometry.stance[:, :2].mean(axis=0) + robot.com[:2]
    record["moment_arm"] = 0.25 * length
    record["contact_force"] = 0.05 * robot.mass * GRAVITY
    record["still_speed"] = 0.12 * length / time
    record["kicked_speed"] = 0.25 * length / time
    record["settled_reach"] = 0.08 * length
    return record


@njit(cache=True, error_model="numpy")
def _tick(
    parameters: NDArray[np.void],
    memory: NDArray[np.void],
    motion: NDArray[np.void],
    values: Array,
    command: Array,
    torque: Array,
) -> None:
    p, m, x = parameters[0], memory[0], motion[0]
    angles = values[JOINTS:JOINT_VELOCITIES].reshape(4, 3)
    rates = values[JOINT_VELOCITIES:FORCES].reshape(4, 3)
    jacobians, inertias, torques = np.empty((4, 3, 3)), np.empty((4, 3, 3)), np.empty((4, 3))
    _observe(p, m, x, values, angles, rates, jacobians, inertias, torques)
    advance(p, m, x, command)
    for leg in range(4):
        if m.leg[leg] == SWING:
            place_foot(p, m, x, leg)
    _stand(p, m, x, angles, rates, jacobians, torques)
    for leg in range(4):
        if m.leg[leg] != STANCE:
            swing_torque(p, m, x, leg, angles[leg], rates[leg], jacobians[leg], inertias[leg], torques[leg])
        for joint in range(3):
            limit = p.torque_limit[leg, joint]
            torque[3 * leg + joint] = min(limit, max(-limit, torques[leg, joint]))


@njit(cache=True, error_model="numpy")
def _observe(
    p: np.void,
    m: np.void,
    x: np.void,
    values: Array,
    angles: Array,
    rates: Array,
    jacobians: Array,
    inertias: Array,
    torques: Array,
) -> None:
    """Fill the motion record, and each leg's Jacobian, inertia and gravity torque."""
    w, i, j, k = values[ORIENTATION], values[ORIENTATION + 1], values[ORIENTATION + 2], values[ORIENTATION + 3]
    r = x.rotation
    r[0, 0], r[0, 1], r[0, 2] = 1 - 2 * (j * j + k * k), 2 * (i * j - k * w), 2 * (i * k + j * w)
    r[1, 0], r[1, 1], r[1, 2] = 2 * (i * j + k * w), 1 - 2 * (i * i + k * k), 2 * (j * k - i * w)
    r[2, 0], r[2, 1], r[2, 2] = 2 * (i * k - j * w), 2 * (j * k + i * w), 1 - 2 * (i * i + j * j)
    x.yaw = np.arctan2(r[1, 0], r[0, 0])
    x.roll = np.arctan2(r[2, 1], r[2, 2])
    x.pitch = -np.arcsin(min(1.0, max(-1.0, r[2, 0])))
    spin = values[RATE:JOINTS]
    gravity = np.empty(3)
    moment = np.empty(3)
    for a in range(3):
        x.position[a] = values[a]
        x.velocity[a] = values[VELOCITY + a]
        x.rate[a] = r[a, 0] * spin[0] + r[a, 1] * spin[1] + r[a, 2] * spin[2]
        gravity[a] = -GRAVITY * r[2, a]
        moment[a] = p.trunk_mass * p.trunk_com[a]
    foot, speed = np.empty(3), np.empty(3)
    for leg in range(4):
        leg_forward(p.hips[leg], p.chain[leg, 0], p.chain[leg, 1], p.chain[leg, 2], angles[leg], foot)
        leg_jacobian(p.chain[leg, 0], p.chain[leg, 1], p.chain[leg, 2], angles[leg], jacobians[leg])
        leg_terms(
            p.hips[leg],
            p.chain[leg],
            angles[leg],
            p.link_mass[leg],
            p.link_com[leg],
            p.link_inertia[leg],
            gravity,
            moment,
            torques[leg],
            inertias[leg],
        )
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            speed[a] = spin[b] * foot[c] - spin[c] * foot[b]
            for q in range(3):
                speed[a] += jacobians[leg, a, q] * rates[leg, q]
        for a in range(3):
            x.feet[leg, a] = r[a, 0] * foot[0] + r[a, 1] * foot[1] + r[a, 2] * foot[2]
            x.feet_velocity[leg, a] = x.velocity[a] + r[a, 0] * speed[0] + r[a, 1] * speed[1] + r[a, 2] * speed[2]
        x.contact[leg] = values[FORCES + leg] > p.contact_force
    for a in range(3):
        x.com[a] = (r[a, 0] * moment[0] + r[a, 1] * moment[1] + r[a, 2] * moment[2]) / p.mass
    # Slope of the ground along the heading, from the last contacts of the front and hind feet.
    c, s = np.cos(x.yaw), np.sin(x.yaw)
    length = 0.0
    for leg in range(4):
        along = c * x.feet[leg, 0] + s * x.feet[leg, 1]
        length += 0.5 * along if leg < 2 else -0.5 * along
    rise = 0.5 * (m.ground[0] + m.ground[1] - m.ground[2] - m.ground[3])
    x.slope = min(0.6, max(-0.6, rise / max(length, 0.5 * p.hips[0, 0])))


@njit(cache=True, error_model="numpy")
def _stand(p: np.void, m: np.void, x: np.void, angles: Array, rates: Array, jacobians: Array, torques: Array) -> None:
    """Add the torques of the stance legs: the wanted trunk acceleration, shared out as contact forces."""
    c, s = np.cos(x.yaw), np.sin(x.yaw)
    weight = p.mass * GRAVITY
    vx, vy, turn = m.reference[0], m.reference[1], m.reference[2]
    # The wanted velocity turns with the trunk.
    ax = p.velocity_gain * (c * vx - s * vy - x.velocity[0]) - turn * (s * vx + c * vy)
    ay = p.velocity_gain * (s * vx + c * vy - x.velocity[1]) + turn * (c * vx - s * vy)
    spin_gain = p.yaw_gain * (turn - x.rate[2])
    if m.mode == STANDING:
        centre_x, centre_y, heading_x, heading_y = 0.0, 0.0, 0.0, 0.0
        for leg in range(4):
            centre_x += 0.25 * x.feet[leg, 0]
            centre_y += 0.25 * x.feet[leg, 1]
            end = 1.0 if leg < 2 else -1.0
            heading_x += end * x.feet[leg, 0]
            heading_y += end * x.feet[leg, 1]
        ax += p.hold_stiffness * (centre_x - x.com[0])
        ay += p.hold_stiffness * (centre_y - x.com[1])
        twist = np.arctan2(c * heading_y - s * heading_x, c * heading_x + s * heading_y)
        spin_gain += p.hold_stiffness * twist
    size = np.sqrt(ax * ax + ay * ay)
    if size > p.acceleration_limit:
        ax *= p.acceleration_limit / size
        ay *= p.acceleration_limit / size
    ground = 0.25 * (m.ground[0] + m.ground[1] + m.ground[2] + m.ground[3])
    rise = p.height - (x.position[2] - ground)
    az = p.height_stiffness * rise - p.height_damping * x.velocity[2]
    # Roll and pitch about the heading; the trunk follows the ground's slope (nose up is negative pitch).
    roll_rate, pitch_rate = c * x.rate[0] + s * x.rate[1], c * x.rate[1] - s * x.rate[0]
    roll_a = -p.attitude_stiffness * x.roll - p.attitude_damping * roll_rate
    pitch_a = p.attitude_stiffness * (-np.arctan(x.slope) - x.pitch) - p.attitude_damping * pitch_rate
    # Inertia about the heading's axes: pitch and roll are small, so the base's axes will do.
    mx = p.inertia[0, 0] * roll_a + p.inertia[0, 2] * spin_gain
    my = p.inertia[1, 1] * pitch_a
    mz = p.inertia[2, 2] * spin_gain + p.inertia[0, 2] * roll_a
    wrench = np.empty(6)
    wrench[0], wrench[1], wrench[2] = ax / GRAVITY, ay / GRAVITY, 1.0 + az / GRAVITY
    wrench[3] = (c * mx - s * my) / (weight * p.moment_arm)
    wrench[4] = (s * mx + c * my) / (weight * p.moment_arm)
    wrench[5] = mz / (weight * p.moment_arm)
    weights = np.array([1.0, 1.0, 2.0, p.moment_weight, p.moment_weight, 0.5])
    arms = np.empty((4, 3))
    limit = np.zeros(4)
    for leg in range(4):
        for a in range(3):
            arms[leg, a] = x.feet[leg, a] - x.com[a]
        arms[leg, 2] -= p.foot_radius
        if m.leg[leg] == STANCE:
            limit[leg] = 1.5 * min(1.0, (m.load[leg] + p.dt) / max(p.load_s, p.dt))
    stance_forces(arms, wrench, weights, p.moment_arm, p.stance_friction, limit, m.forces, m.dual)
    r = x.rotation
    lever = np.empty(3)
    for a in range(3):
        lever[a] = -p.foot_radius * r[2, a]
    push = np.empty(3)
    for leg in range(4):
        if m.leg[leg] != STANCE:
            continue
        for a in range(3):
            push[a] = weight * (r[0, a] * m.forces[leg, 0] + r[1, a] * m.forces[leg, 1] + r[2, a] * m.forces[leg, 2])
        # The force acts at the sphere's lowest point: its moment about the foot's centre turns the shank too.
        moment_x = lever[1] * push[2] - lever[2] * push[1]
        moment_y = lever[2] * push[0] - lever[0] * push[2]
        moment_z = lever[0] * push[1] - lever[1] * push[0]
        # Thigh and knee turn about Rx(hip)·ŷ.
        about_pitch = np.cos(angles[leg, 0]) * moment_y + np.sin(angles[leg, 0]) * moment_z
        for j in range(3):
            torques[leg, j] -= (
                jacobians[leg, 0, j] * push[0] + jacobians[leg, 1, j] * push[1] + jacobians[leg, 2, j] * push[2]
            )
            torques[leg, j] -= moment_x if j == 0 else about_pitch
            drag = p.friction[leg, j] * np.tanh(rates[leg, j] / 0.5) + p.damping[leg, j] * rates[leg, j]
            torques[leg, j] += p.friction_compensation * drag
