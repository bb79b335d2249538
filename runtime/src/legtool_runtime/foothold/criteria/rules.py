"""What footholds of one leg are judged by: exactly, and coarsely, which is the same at fewer instants and points."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.errors import RobotError
from legtool_runtime.foothold.criteria import dilation
from legtool_runtime.foothold.criteria.leg import Leg, chain
from legtool_runtime.foothold.settings import RESOLUTION_M, CriteriaSettings
from legtool_runtime.robot import Robot

Array32 = NDArray[np.float32]

#: Sub-cells a side of the tables for foot and leg.
_FINE_FOOT, _FINE_LEG = 3, 2
#: Instants of the cycle that are looked at, see :class:`Rules`: exactly, and coarsely at one hip height and over many.
#: Networks are trained on what the coarse checks see.
INSTANTS, COARSE, COARSE_COUNTS = (24, 18, 5), (8, 6, 3), (3, 4, 2)
#: Coarsely at one hip height below a tilted trunk: its thighs run into their limits between so few instants.
COARSE_TILTED = (8, 12, 3)


class Rules(NamedTuple):
    """One leg, and what its footholds are judged by.

    Attributes:
        leg: its chain.
        foot_radius: [m].
        points: (p, 3) along the leg, see :func:`legtool_runtime.foothold.criteria.clearance.clear_leg`.
        thin: the foot's ball, see :func:`legtool_runtime.foothold.criteria.dilation.ball`, and its table's fineness.
        thick: the same for the leg.
        slopes: largest mean and standard deviation.
        contact: share of the swing at either end in which the foot may touch the terrain.
        around: (m, 2) cells within the uncertainty radius.
        instants: at how many the swing path is looked at (FC), the leg's swing, touchdown left out, and its stance,
            touchdown and next lift-off included (LC, KF).
        coarse: whether a hip height that lets the leg lift off from nowhere is taken for one without safe cells.
    """

    leg: Leg
    foot_radius: float
    points: Array32
    thin: tuple[NDArray[np.int32], Array32, int]
    thick: tuple[NDArray[np.int32], Array32, int]
    slopes: tuple[float, float]
    contact: float
    around: NDArray[np.int32]
    instants: tuple[int, int, int]
    coarse: bool


def exact_rules(robot: Robot, leg: int, settings: CriteriaSettings) -> Rules:
    """The criteria as they are, for leg ``leg`` of a robot.

    Raises:
        RobotError: the settings' ankle lies beyond the robot's shank.
    """
    return Rules(
        leg=chain(robot, leg),
        foot_radius=robot.foot_radius,
        points=_leg_points(robot, leg, settings),
        thin=(*dilation.ball(robot.foot_radius, RESOLUTION_M, _FINE_FOOT), _FINE_FOOT),
        thick=(*dilation.ball(settings.leg_radius_m, RESOLUTION_M, _FINE_LEG), _FINE_LEG),
        slopes=(settings.slope_mean, settings.slope_deviation),
        contact=settings.contact_phase,
        around=dilation.disc(settings.uncertainty_m, RESOLUTION_M),
        instants=INSTANTS,
        coarse=False,
    )


def coarse_rules(rules: Rules, *, tilted: bool) -> Rules:
    """Those of a coarse check at one hip height: a third of the instants, of the swing more if the trunk is tilted."""
    return rules._replace(instants=COARSE_TILTED if tilted else COARSE, coarse=True)


def coarse_count_rules(rules: Rules) -> Rules:
    """Those of a coarse count over hip heights: a fifth of the instants, the shank alone, every other cell."""
    box = dilation.disc(1.5 * RESOLUTION_M, RESOLUTION_M)
    return rules._replace(
        # Of the shank every other point; the thigh hardly ever touches first.
        points=np.ascontiguousarray(rules.points[rules.points[:, 0] > 0.5][::2]),
        # A cell that was left out is judged by its neighbours.
        around=np.unique(np.concatenate([rules.around, box]), axis=0),
        instants=COARSE_COUNTS,
    )


def _leg_points(robot: Robot, leg: int, s: CriteriaSettings) -> Array32:
    """Points along the leg at which its clearance is looked up: (p, 3) link, share, 1 where thick."""
    shank, thigh = float(robot.shank_length[leg]), float(robot.thigh_length[leg])
    if s.ankle_m >= shank:
        raise RobotError(f"criteria: ankle_m {s.ankle_m} m is beyond the shank of {shank} m")
    step = 1.15 * s.leg_radius_m
    thin = math.ceil(s.ankle_m / (1.75 * robot.foot_radius))
    out = [(1, 1 - s.ankle_m * k / thin / shank, 0) for k in range(1, thin)]
    thick = math.ceil((shank - s.ankle_m) / step)
    out += [(1, (1 - k / thick) * (1 - s.ankle_m / shank), 1) for k in range(thick + 1)]
    upper = math.ceil(thigh / step)
    out += [(0, k / upper, 1) for k in range(upper)]
    return np.array(out, np.float32)
