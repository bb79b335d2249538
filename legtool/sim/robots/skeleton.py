"""A robot's links as points and as primitives of the ray caster's kind of world: what films and drawings show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.robot import Robot

Array = NDArray[np.float64]


def leg_points(robot: Robot, joints: Array) -> tuple[Array, Array, Array]:
    """Thigh axes, knees and feet, each (4, 3) base frame [m], for joint angles (4, 3) [rad]."""
    c, s = np.cos(joints[:, 0]), np.sin(joints[:, 0])
    lateral = robot.abduction_offset
    hips = robot.hips + np.stack([np.zeros(4), c * lateral, s * lateral], axis=1)
    down = -robot.thigh_length * np.cos(joints[:, 1])
    knees = hips + np.stack([-robot.thigh_length * np.sin(joints[:, 1]), -s * down, c * down], axis=1)
    return hips, knees, robot.feet(joints)
