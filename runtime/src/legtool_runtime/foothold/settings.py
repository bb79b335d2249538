"""Settings of the foothold evaluation criteria."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.checks import Bounds, within
from legtool_runtime.errors import StateError
from legtool_runtime.robot import Robot

#: Cells a side of a heightmap, and the side of a cell [m] (ViTAL, appendix A).
SIZE, RESOLUTION_M = 33, 0.02
#: Thigh and shank of HyQ [m]: lengths below are for its legs, and scale with a robot's.
_HYQ_LEG_M = 0.68
_BOUNDS = {
    "slope_mean": Bounds(0.0, 10.0),
    "slope_deviation": Bounds(0.0, 10.0),
    "leg_radius_m": Bounds(0.005, 0.2),
    "ankle_m": Bounds(0.0, 0.5),
    "swing_height_m": Bounds(0.01, 1.0),
    "contact_phase": Bounds(0.0, 0.4),
    "uncertainty_m": Bounds(0.0, 0.2),
}


def leg_length(robot: Robot) -> float:
    """Longest thigh and shank of a robot [m]."""
    return float((robot.thigh_length + robot.shank_length).max())


def hip_heights(robot: Robot, count: int = 31) -> NDArray[np.float64]:
    """The finite set of hip heights above the ground (appendix F): 0.2 to 0.8 m for HyQ, scaled with the legs [m]."""
    return np.linspace(0.2, 0.8, count) * (leg_length(robot) / _HYQ_LEG_M)


@dataclass(frozen=True)
class CriteriaSettings:
    """Thresholds of the criteria, and the swing they assume.

    Attributes:
        slope_mean: largest mean of the slopes to the 8 neighbours (TR).
        slope_deviation: largest standard deviation of these slopes (TR).
        leg_radius_m: of the bounding region around thigh and shank that must stay clear of the terrain (LC).
        ankle_m: below this distance from the foot's centre the region is as thick as the foot (LC).
        swing_height_m: of the swing's apex above the higher of lift-off and touchdown.
        contact_phase: share of the swing, at its begin and at its end, in which the foot may touch the terrain (FC).
        uncertainty_m: safe cells with an unsafe one within this radius are discarded (Remark 1).
    """

    slope_mean: float = 0.4
    slope_deviation: float = 0.3
    leg_radius_m: float = 0.04
    ankle_m: float = 0.1
    swing_height_m: float = 0.12
    contact_phase: float = 0.08
    uncertainty_m: float = 0.02

    def __post_init__(self) -> None:
        within("criteria settings", self, _BOUNDS, StateError)

    @classmethod
    def for_robot(cls, robot: Robot) -> CriteriaSettings:
        """The defaults, lengths of leg and swing scaled with the robot's legs."""
        scale = leg_length(robot) / _HYQ_LEG_M
        return cls(leg_radius_m=0.04 * scale, ankle_m=0.1 * scale, swing_height_m=0.12 * scale)

    def to_dict(self) -> dict[str, Any]:
        """The settings as plain JSON types."""
        return asdict(self)
