"""One gait cycle in compiled code: where the hip is at a time, and where the foot is at a phase of the swing."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.foothold.gait import hip_velocity, nominal_foothold
from legtool_runtime.foothold.tuples import Tuple
from legtool_runtime.robot import Robot

Array32 = NDArray[np.float32]


class Cycle(NamedTuple):
    """One gait cycle in the map's frame: x, y from the map's centre, τ = 0 at touchdown.

    ``lift`` is where the foot's centre is at lift-off, ``aim`` the nominal foothold [m]; ``start`` the phase from which
    the swing is judged; ``height`` that of the apex above the higher of lift-off and touchdown [m]; ``roll`` and
    ``pitch`` those of the trunk, throughout [rad].
    """

    hip_x: float
    hip_y: float
    velocity_x: float
    velocity_y: float
    velocity_z: float
    yaw_rate: float
    lift_x: float
    lift_y: float
    lift_z: float
    aim_x: float
    aim_y: float
    swing_s: float
    stance_s: float
    start: float
    height: float
    roll: float
    pitch: float


def cycle_of(robot: Robot, t: Tuple, swing_height_m: float) -> Cycle:
    """The cycle of a tuple; where the foot lifts off is about right only, and at no height yet, see :mod:`.liftoff`."""
    vx, vy, vz = hip_velocity(robot, t.leg, t.base_twist, roll=t.roll, pitch=t.pitch)
    hip_x, hip_y = t.hip
    aim_x, aim_y = nominal_foothold(robot, t.leg, (vx, vy, vz), t.gait) if t.nominal is None else (0.0, 0.0)
    speed = math.hypot(vx, vy)
    back = t.gait.step_length_m / speed if speed > 1e-3 else 0.0
    return Cycle(
        hip_x, hip_y, vx, vy, vz, t.base_twist[5],
        aim_x - back * vx, aim_y - back * vy, 0.0, aim_x, aim_y,
        t.gait.swing_s, t.gait.stance_s, t.gait.swing_phase, swing_height_m, t.roll, t.pitch,
    )  # fmt: skip


@kernel
def hip_at(cycle: Cycle, hip_z: float, tau: float) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Where the hip is at time ``tau`` [s]: x, y, z [m], cosine and sine of the yaw since touchdown."""
    yaw = cycle.yaw_rate * tau
    return (
        np.float32(cycle.hip_x + cycle.velocity_x * tau),
        np.float32(cycle.hip_y + cycle.velocity_y * tau),
        np.float32(hip_z + cycle.velocity_z * tau),
        np.float32(np.cos(yaw)),
        np.float32(np.sin(yaw)),
    )


@kernel
def trunk_at(cycle: Cycle, tau: float) -> tuple[np.float32, ...]:
    """The trunk's axes at time ``tau`` [s], Rz(yaw since touchdown) Ry(pitch) Rx(roll), as nine numbers row by row."""
    yaw = cycle.yaw_rate * tau
    cr, sr, cp, sp = np.cos(cycle.roll), np.sin(cycle.roll), np.cos(cycle.pitch), np.sin(cycle.pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    f = np.float32
    return (
        f(cy * cp), f(cy * sp * sr - sy * cr), f(cy * sp * cr + sy * sr),
        f(sy * cp), f(sy * sp * sr + cy * cr), f(sy * sp * cr - cy * sr),
        f(-sp), f(cp * sr), f(cp * cr),
    )  # fmt: skip


@kernel
def swing_weights(phase: float, out: Array32) -> None:
    """Write the swing's weights (4,) at ``phase`` 0 to 1: of the way across, of lift-off, touchdown and apex.

    Across, a cycloid; up to the apex and down again, cubics at rest at both ends.
    """
    out[0] = phase - np.sin(2.0 * np.pi * phase) / (2.0 * np.pi)
    u = 2.0 * phase if phase < 0.5 else 2.0 * (1.0 - phase)
    risen = u * u * (3.0 - 2.0 * u)
    out[1] = 1.0 - risen if phase < 0.5 else 0.0
    out[2] = 0.0 if phase < 0.5 else 1.0 - risen
    out[3] = risen


@kernel
def swing_phases(start: float, first: float, last: float, out: Array32) -> None:
    """Write phases (k,) of the swing from ``max(start, first)`` to ``last``, closer where the foot is fast."""
    low, high = max(start, first), last
    n = out.shape[0]
    w = np.empty(4, np.float32)
    # Halfway between equal steps in time and equal steps across: the foot's spacing is at most 1.33 / n of its way.
    swing_weights(low, w)
    begin = 0.5 * (low + w[0])
    swing_weights(high, w)
    end = 0.5 * (high + w[0])
    phase = low
    for k in range(n):
        wanted = begin + (end - begin) * k / (n - 1)
        for _ in range(3):  # Newton's steps; the slope is never below a half
            value = phase - np.sin(2.0 * np.pi * phase) / (4.0 * np.pi)
            slope = 1.0 - 0.5 * np.cos(2.0 * np.pi * phase)
            phase -= (value - wanted) / slope
        out[k] = phase


@kernel
def place_swing(cycle: Cycle, phase: float, candidates: Array32, foot: Array32) -> None:
    """Write the foot's centre (3, n) at a phase of the swing to each of ``candidates`` (3, n)."""
    w = np.empty(4, np.float32)
    swing_weights(phase, w)
    across, from_lift, from_end, from_apex = w[0], w[1], w[2], w[3]
    lift_x, lift_y = np.float32(cycle.lift_x), np.float32(cycle.lift_y)
    lift, rise = np.float32(cycle.lift_z), np.float32(cycle.height)
    xs, ys, zs = candidates[0], candidates[1], candidates[2]
    fx, fy, fz = foot[0], foot[1], foot[2]
    for j in range(xs.shape[0]):
        fx[j] = lift_x + (xs[j] - lift_x) * across
    for j in range(xs.shape[0]):
        fy[j] = lift_y + (ys[j] - lift_y) * across
    for j in range(xs.shape[0]):
        z = zs[j]
        apex = (z if z > lift else lift) + rise
        fz[j] = from_lift * lift + from_end * z + from_apex * apex
