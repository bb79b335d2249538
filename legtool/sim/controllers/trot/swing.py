"""Swing legs: where the foot is set down, the path it takes there, and the joint torques that move it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool.sim.controllers.trot.gait import SWING
from legtool_runtime.cache import kernel
from legtool_runtime.robot import leg_jacobian

Array = NDArray[np.float64]

#: Share of the swing at which the foot is highest: early, so that it comes down slowly.
APEX = 0.45


@kernel
def place_foot(p: np.record, m: np.record, x: np.record, leg: int) -> None:
    """Aim the swinging foot: below its hip at mid-stance, ahead by half a stance, plus Raibert's term."""
    if m.clock >= p.arrival * p.swing_s:
        return
    left = p.swing_s - m.clock
    stance = p.swing_s + 2.0 * p.full_stance_s
    vx, vy, turn = m.reference[0], m.reference[1], m.reference[2]
    c, s = np.cos(x.yaw), np.sin(x.yaw)
    error_x = x.velocity[0] - (c * vx - s * vy)
    error_y = x.velocity[1] - (s * vx + c * vy)
    # The trunk's heading at the middle of the coming stance.
    middle = x.yaw + turn * (left + 0.5 * stance)
    cm, sm = np.cos(middle), np.sin(middle)
    ahead_x = stance * p.foothold_neutral * vx
    ahead_y = stance * p.foothold_neutral * vy
    offset_x = c * ahead_x - s * ahead_y + p.foothold_gain_s * error_x
    offset_y = s * ahead_x + c * ahead_y + p.foothold_gain_s * error_y
    offset_x += (cm - c) * p.nominal[leg, 0] - (sm - s) * p.nominal[leg, 1]
    offset_y += (sm - s) * p.nominal[leg, 0] + (cm - c) * p.nominal[leg, 1]
    reach = np.sqrt(offset_x * offset_x + offset_y * offset_y)
    if reach > p.foothold_reach:
        offset_x *= p.foothold_reach / reach
        offset_y *= p.foothold_reach / reach
    beside_x = c * p.nominal[leg, 0] - s * p.nominal[leg, 1] + offset_x + x.velocity[0] * left
    beside_y = s * p.nominal[leg, 0] + c * p.nominal[leg, 1] + offset_y + x.velocity[1] * left
    m.target[leg, 0] = x.position[0] + beside_x
    m.target[leg, 1] = x.position[1] + beside_y
    # Ground below the target: the plane through the last contacts.
    centre = 0.0
    ground = 0.0
    for other in range(4):
        centre += 0.25 * (c * x.feet[other, 0] + s * x.feet[other, 1])
        ground += 0.25 * m.ground[other]
    ground += x.slope * (c * beside_x + s * beside_y - centre)
    m.target[leg, 2] = ground + p.foot_radius


@kernel
def swing_reference(
    p: np.record, m: np.record, leg: int, position: Array, velocity: Array, acceleration: Array
) -> None:
    """Write the foot's wanted motion (3,) each, world frame: a cycloid across; up, and down until there is ground."""
    if m.leg[leg] == SWING:
        t = m.clock / p.swing_s
        rate = 1.0 / p.swing_s
        # Across, the foot arrives early and comes down straight, so that the instant of touchdown moves no foothold.
        share = min(1.0, t / p.arrival)
        pace = rate / p.arrival
        angle = 2 * np.pi * share
        for i in range(2):
            way = m.target[leg, i] - m.lift_off[leg, i]
            position[i] = m.lift_off[leg, i] + way * (share - np.sin(angle) / (2 * np.pi))
            velocity[i] = way * pace * (1.0 - np.cos(angle))
            acceleration[i] = way * pace * pace * 2 * np.pi * np.sin(angle)
        apex = max(m.lift_off[leg, 2], m.target[leg, 2]) + p.swing_height
        if t < APEX:
            _cubic(m.lift_off[leg, 2], apex, 0.0, APEX * p.swing_s, t / APEX, position, velocity, acceleration)
        else:
            share, span = (t - APEX) / (1.0 - APEX), (1.0 - APEX) * p.swing_s
            _cubic(apex, m.target[leg, 2], -p.search_speed, span, share, position, velocity, acceleration)
    else:
        depth = min(p.search_speed * m.late[leg], p.search_depth)
        for i in range(3):
            position[i] = m.target[leg, i]
            velocity[i] = 0.0
            acceleration[i] = 0.0
        position[2] -= depth
        if depth < p.search_depth:
            velocity[2] = -p.search_speed


@kernel
def _cubic(
    start: float,
    end: float,
    end_speed: float,
    span: float,
    share: float,
    position: Array,
    velocity: Array,
    acceleration: Array,
) -> None:
    """Write the vertical motion at ``share`` of ``span`` [s] on a cubic from rest to ``end_speed``."""
    u, way, slope = share, end - start, end_speed * span
    position[2] = start + way * u * u * (3 - 2 * u) + slope * u * u * (u - 1)
    velocity[2] = (way * 6 * u * (1 - u) + slope * u * (3 * u - 2)) / span
    acceleration[2] = (way * (6 - 12 * u) + slope * (6 * u - 2)) / (span * span)


@kernel
def swing_torque(
    p: np.record,
    m: np.record,
    x: np.record,
    leg: int,
    angles: Array,
    rates: Array,
    jacobian: Array,
    inertia: Array,
    torque: Array,
) -> None:
    """Add to ``torque`` (3,) what moves the foot along its reference: inverse dynamics of the leg on a steady trunk."""
    position, velocity, acceleration = np.empty(3), np.empty(3), np.empty(3)
    swing_reference(p, m, leg, position, velocity, acceleration)
    wanted = np.empty(3)
    relative = np.empty(3)
    for i in range(3):
        lag = position[i] - x.position[i] - x.feet[leg, i]
        slip = velocity[i] - x.feet_velocity[leg, i]
        wanted[i] = acceleration[i] + p.swing_stiffness * lag + p.swing_damping * slip
        relative[i] = velocity[i] - x.velocity[i]
    # What the joints' motion gives by itself: the Jacobian's rate of change times the joint rates.
    step = 1e-4
    ahead = np.empty((3, 3))
    leg_jacobian(p.chain[leg, 0], p.chain[leg, 1], p.chain[leg, 2], angles + step * rates, ahead)
    target = np.empty(3)
    speed = np.empty(3)
    for i in range(3):
        target[i] = 0.0
        speed[i] = 0.0
        for k in range(3):
            target[i] += x.rotation[k, i] * wanted[k] - (ahead[i, k] - jacobian[i, k]) / step * rates[k]
            speed[i] += x.rotation[k, i] * relative[k]
    joint_acceleration = _damped_solve(jacobian, target)
    joint_rate = _damped_solve(jacobian, speed)
    for j in range(3):
        for k in range(3):
            torque[j] += inertia[j, k] * joint_acceleration[k]
        torque[j] += p.armature[leg, j] * joint_acceleration[j]
        drag = p.friction[leg, j] * np.tanh(joint_rate[j] / p.friction_rate[leg, j]) + p.damping[leg, j] * joint_rate[j]
        torque[j] += p.compensated[leg, j] * drag


@kernel
def _damped_solve(jacobian: Array, right: Array) -> Array:
    """Jᵀ(JJᵀ + λ)⁻¹ b: the inverse that stays bounded where the leg is straight."""
    a = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            a[i, j] = 0.0
            for k in range(3):
                a[i, j] += jacobian[i, k] * jacobian[j, k]
        a[i, i] += 1e-4
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    determinant = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    y = np.empty(3)
    y[0] = (
        c00 * right[0]
        + (a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]) * right[1]
        + (a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]) * right[2]
    ) / determinant
    y[1] = (
        c01 * right[0]
        + (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) * right[1]
        + (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]) * right[2]
    ) / determinant
    y[2] = (
        c02 * right[0]
        + (a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]) * right[1]
        + (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) * right[2]
    ) / determinant
    out = np.zeros(3)
    for k in range(3):
        for i in range(3):
            out[k] += jacobian[i, k] * y[i]
    return out
