"""What a leg reaches within its joint limits: in closed form or tabulated, for the dense foothold network."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.robot import Robot

#: Number of positions x of the foot relative to the hip for which its reach is tabulated.
PLACES = 201


def inward(offset: float, low: float) -> tuple[float, float]:
    """Place a and slope b of what the abduction joint's lower limit asks: distance in the leg's plane ≥ (a - y) b."""
    if not -0.9 * math.pi < low < -1e-3:
        return 0.0, 0.0
    return offset * math.cos(low), -1 / math.sin(low)


def outward(offset: float, high: float) -> tuple[float, float]:
    """The same for its upper limit: distance ≥ (y - a) b."""
    if not 1e-3 < high < 0.9 * math.pi:
        return 0.0, 0.0
    return offset * math.cos(high), 1 / math.sin(high)


def extents_of(robot: Robot, leg: int, length: float) -> NDArray[np.float64]:
    """Least and greatest distance below the hip that a foot reaches in the leg's plane: (2, PLACES) [m], along x.

    Where it reaches none, the greatest is zero and the least the leg's length.
    """
    x = np.linspace(-length, length, PLACES)[:, None]
    w = np.linspace(0, length, 1001)[None]
    thigh, shank = robot.thigh_length[leg], robot.shank_length[leg]
    cosine = (x**2 + w**2 - thigh**2 - shank**2) / (2 * thigh * shank)
    knee = robot.knee_sign[leg] * np.arccos(np.clip(cosine, -1, 1))
    # As legtool_runtime.robot.leg_inverse has it.
    angle = np.arctan2(-x, w) - np.arctan2(shank * np.sin(knee), thigh + shank * np.cos(knee))
    limits = robot.joint_limits[leg]
    good = np.abs(cosine) <= 1
    for joint, value in ((1, angle), (2, knee)):
        good &= (value >= limits[joint, 0]) & (value <= limits[joint, 1])
    least = np.where(good.any(axis=1), w[0, good.argmax(axis=1)], length)
    most = np.where(good.any(axis=1), w[0, w.shape[1] - 1 - good[:, ::-1].argmax(axis=1)], 0.0)
    return np.stack([least, most])
