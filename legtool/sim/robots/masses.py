"""Masses and inertias that cannot be a robot's: left out of its file, or in other units."""

from __future__ import annotations

import numpy as np

from legtool.sim.robots.robot import SimRobot
from legtool_runtime.robot import LEGS

#: A thigh or shank lighter than this share of the robot is none, nor is a trunk.
_LINK, _TRUNK = 5e-4, 0.1
#: Radius of gyration over length, of trunk (by the distance of its hips) and links; that of a rod or box is 0.29.
_COMPACT, _SPREAD = 0.06, 1.0


def doubtful_masses(robot: SimRobot) -> list[str]:
    """What is odd about a robot's masses and inertias, a line each: likely causes where it does not walk."""
    geometry, found = robot.geometry, []
    if robot.trunk_mass < _TRUNK * robot.mass:
        found.append(f"its trunk weighs {robot.trunk_mass:.3g} kg of {robot.mass:.3g} kg")
    length = float(np.ptp(geometry.hips[:, 0]))
    found += _inertia("its trunk", robot.trunk_inertia, robot.trunk_mass, length)
    for leg in range(4):
        for k, length in ((1, geometry.thigh_length[leg]), (2, geometry.shank_length[leg])):
            name, mass = f"the {('hip', 'thigh', 'shank')[k]} of {LEGS[leg]}", float(robot.link_mass[leg, k])
            if mass < _LINK * robot.mass:
                found.append(f"{name} weighs {1000 * mass:.3g} g of {robot.mass:.3g} kg")
            else:
                found += _inertia(name, robot.link_inertia[leg, k], mass, float(length))
    return found


def _inertia(name: str, inertia: np.ndarray, mass: float, length: float) -> list[str]:
    radius = float(np.sqrt(np.linalg.eigvalsh(inertia).max() / max(mass, 1e-12)))
    if _COMPACT * length <= radius <= _SPREAD * length:
        return []
    return [f"{name} has the inertia of a body {100 * radius / 0.29:.2g} cm long, and is {100 * length:.2g} cm long"]
