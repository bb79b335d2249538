"""The kinematics of one leg in compiled code: many feet at once, in single precision.

Angles are never formed: a joint is within its limits if the cosine of its distance to the middle of its range is at
least that of half the range, and cosines and sines follow from lengths (the inverse of
:func:`legtool_runtime.robot.leg_forward`). Loops over feet have no branches, so that they compile to vector code.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.foothold.criteria.gait_cycle import Cycle, hip_at, trunk_at
from legtool_runtime.robot import Robot

Array32 = NDArray[np.float32]


class Leg(NamedTuple):
    """One leg's chain in single precision, see :func:`chain`: lengths [m], and of each joint the range's middle.

    ``offset2`` and ``links2`` are squares of lengths [m²], ``twice`` is 1 / (2 thigh shank). Of each joint's range:
    cosine and sine of the middle, cosine of half.
    """

    offset: np.float32
    thigh: np.float32
    shank: np.float32
    knee_sign: np.float32
    offset2: np.float32
    links2: np.float32
    twice: np.float32
    hip_cos: np.float32
    hip_sin: np.float32
    hip_range: np.float32
    thigh_cos: np.float32
    thigh_sin: np.float32
    thigh_range: np.float32
    knee_cos: np.float32
    knee_sin: np.float32
    knee_range: np.float32


def chain(robot: Robot, leg: int) -> Leg:
    """The chain of one leg of a robot."""
    arcs = []
    for low, high in robot.joint_limits[leg]:
        half = 0.5 * (high - low)
        # A range of a full turn or more holds every angle.
        arcs += [math.cos(0.5 * (low + high)), math.sin(0.5 * (low + high)), math.cos(half) if half < math.pi else -2.0]
    lengths = robot.abduction_offset[leg], robot.thigh_length[leg], robot.shank_length[leg]
    a, t, s = (np.float32(length) for length in lengths)
    sign, twice = np.float32(robot.knee_sign[leg]), np.float32(1.0 / (2.0 * lengths[1] * lengths[2]))
    return Leg(a, t, s, sign, a * a, t * t + s * s, twice, *(np.float32(value) for value in arcs))


@kernel
def turn_joints(
    leg: Leg, x: float, y: float, z: float
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Turn the joints such that the foot lies at x, y, z from the abduction axis, in the trunk's frame.

    Returns:
        the least margin, cosine and sine of the abduction, and of the thigh. A margin below zero is a foot out of reach
        or a joint beyond its limits.
    """
    one, tiny = np.float32(1.0), np.float32(1e-9)
    yz = y * y + z * z
    lateral = yz - leg.offset2
    w = np.sqrt(lateral if lateral > tiny else tiny)
    under = one / (yz + tiny)
    c = (leg.offset * y - w * z) * under
    sn = (w * y + leg.offset * z) * under
    length2 = x * x + w * w
    cos_knee = (length2 - leg.links2) * leg.twice
    sin2 = one - cos_knee * cos_knee
    sin_knee = leg.knee_sign * np.sqrt(sin2 if sin2 > tiny else tiny)
    # With the knee bent, the foot lies at (A, B) along and across the thigh; the thigh turns it to (x, w).
    along, across = leg.thigh + leg.shank * cos_knee, leg.shank * sin_knee
    over = one / (length2 + tiny)
    cos_thigh = (along * w - across * x) * over
    sin_thigh = -(along * x + across * w) * over
    m = sin2 if sin2 < lateral else lateral
    other = c * leg.hip_cos + sn * leg.hip_sin - leg.hip_range
    m = other if other < m else m
    other = cos_thigh * leg.thigh_cos + sin_thigh * leg.thigh_sin - leg.thigh_range
    m = other if other < m else m
    other = cos_knee * leg.knee_cos + sin_knee * leg.knee_sin - leg.knee_range
    m = other if other < m else m
    return m, c, sn, cos_thigh, sin_thigh


@kernel
def bend_leg(leg: Leg, cycle: Cycle, hip_z: float, tau: float, foot: Array32, links: Array32, margin: Array32) -> None:
    """Bend the leg to each foot ``foot`` (3, n) at time ``tau`` [s], and lower ``margin`` (n,) to its least margin.

    Writes ``links`` (6, n): knee and thigh axis x, y, z.
    """
    if cycle.roll != 0.0 or cycle.pitch != 0.0:
        _bend_tilted(leg, cycle, hip_z, tau, foot, links, margin)
        return
    hx, hy, hz, cy, sy = hip_at(cycle, hip_z, tau)
    a, t = leg.offset, leg.thigh
    fx, fy, fz = foot[0], foot[1], foot[2]
    for j in range(margin.shape[0]):
        dx, dy = fx[j] - hx, fy[j] - hy
        m, c, sn, cos_thigh, sin_thigh = turn_joints(leg, cy * dx + sy * dy, cy * dy - sy * dx, fz[j] - hz)
        margin[j] = m if m < margin[j] else margin[j]
        kx, kw = -t * sin_thigh, t * cos_thigh
        ky, kz = c * a + sn * kw, sn * a - c * kw
        links[0, j] = hx + cy * kx - sy * ky
        links[1, j] = hy + sy * kx + cy * ky
        links[2, j] = hz + kz
        links[3, j] = hx - sy * c * a
        links[4, j] = hy + cy * c * a
        links[5, j] = hz + sn * a


@kernel
def _bend_tilted(
    leg: Leg, cycle: Cycle, hip_z: float, tau: float, foot: Array32, links: Array32, margin: Array32
) -> None:
    """:func:`bend_leg` below a trunk of any attitude: in the trunk's frame, and back."""
    hx, hy, hz, _, _ = hip_at(cycle, hip_z, tau)
    xx, xy, xz, yx, yy, yz, zx, zy, zz = trunk_at(cycle, tau)
    a, t = leg.offset, leg.thigh
    fx, fy, fz = foot[0], foot[1], foot[2]
    for j in range(margin.shape[0]):
        dx, dy, dz = fx[j] - hx, fy[j] - hy, fz[j] - hz
        m, c, sn, cos_thigh, sin_thigh = turn_joints(
            leg, xx * dx + yx * dy + zx * dz, xy * dx + yy * dy + zy * dz, xz * dx + yz * dy + zz * dz
        )
        margin[j] = m if m < margin[j] else margin[j]
        kx, kw = -t * sin_thigh, t * cos_thigh
        ay, az = c * a, sn * a
        ky, kz = ay + sn * kw, az - c * kw
        links[0, j] = hx + xx * kx + xy * ky + xz * kz
        links[1, j] = hy + yx * kx + yy * ky + yz * kz
        links[2, j] = hz + zx * kx + zy * ky + zz * kz
        links[3, j] = hx + xy * ay + xz * az
        links[4, j] = hy + yy * ay + yz * az
        links[5, j] = hz + zy * ay + zz * az


@kernel
def reach_foot(leg: Leg, cycle: Cycle, hip_z: float, tau: float, foot: Array32, margin: Array32) -> None:
    """Lower ``margin`` (n,) to the leg's least on each of ``foot`` (3, n) at time ``tau`` [s]."""
    if cycle.roll != 0.0 or cycle.pitch != 0.0:
        _reach_tilted(leg, cycle, hip_z, tau, foot, margin)
        return
    hx, hy, hz, cy, sy = hip_at(cycle, hip_z, tau)
    fx, fy, fz = foot[0], foot[1], foot[2]
    for j in range(margin.shape[0]):
        dx, dy = fx[j] - hx, fy[j] - hy
        m = turn_joints(leg, cy * dx + sy * dy, cy * dy - sy * dx, fz[j] - hz)[0]
        margin[j] = m if m < margin[j] else margin[j]


@kernel
def _reach_tilted(leg: Leg, cycle: Cycle, hip_z: float, tau: float, foot: Array32, margin: Array32) -> None:
    """:func:`reach_foot` below a trunk of any attitude."""
    hx, hy, hz, _, _ = hip_at(cycle, hip_z, tau)
    xx, xy, xz, yx, yy, yz, zx, zy, zz = trunk_at(cycle, tau)
    fx, fy, fz = foot[0], foot[1], foot[2]
    for j in range(margin.shape[0]):
        dx, dy, dz = fx[j] - hx, fy[j] - hy, fz[j] - hz
        m = turn_joints(leg, xx * dx + yx * dy + zx * dz, xy * dx + yy * dy + zy * dz, xz * dx + yz * dy + zz * dz)[0]
        margin[j] = m if m < margin[j] else margin[j]
