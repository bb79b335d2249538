"""Stance legs: the trunk's wanted acceleration, shared out as contact forces, and the joint torques that give them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool.sim.controllers.trot.forces import stance_forces
from legtool.sim.controllers.trot.gait import GRAVITY, STANCE, STANDING
from legtool_runtime.cache import kernel

Array = NDArray[np.float64]


@kernel
def stand_torques(
    p: np.record, m: np.record, x: np.record, angles: Array, rates: Array, jacobians: Array, torques: Array
) -> None:
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
            drag = p.friction[leg, j] * np.tanh(rates[leg, j] / p.friction_rate[leg, j])
            drag += p.damping[leg, j] * rates[leg, j]
            torques[leg, j] += p.compensated[leg, j] * drag
