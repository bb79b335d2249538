"""Legs for compiled code, and how straight and how folded a standing one may be."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.errors import TrackingError
from legtool_runtime.robot import Robot

Array = NDArray[np.float64]

#: Share of the straight leg that a standing leg may use; straighter ones turn singular, and all torques saturate.
LONGEST = 0.92
#: Share of the straight leg below which a standing leg counts as too folded.
SHORTEST = 0.40
#: Kept from the limits of the knees [rad].
_KNEE_MARGIN = 0.05


class Legs(NamedTuple):
    """Legs for compiled code: ``hips`` (4, 3) from the centre of mass, lengths (4,) [m], and bounds (4,) of the way
    from thigh axis to foot; ``reach`` (4,) that way at the knees' own limits; ``size`` the straight leg's length,
    ``radius`` of thigh and shank."""

    hips: Array
    offset: Array
    thigh: Array
    shank: Array
    sign: Array
    shortest: Array
    longest: Array
    reach: Array
    size: float
    radius: float

    @classmethod
    def of(cls, robot: Robot, com_offset: ArrayLike = (0.0, 0.0, 0.0)) -> Legs:
        """The legs of a robot whose centre of mass is at ``com_offset`` (3,) in the base frame [m].

        Raises:
            TrackingError: an offset that is not three finite numbers.
        """
        com = np.asarray(com_offset, dtype=np.float64)
        if com.shape != (3,) or not np.isfinite(com).all():
            raise TrackingError(f"centre of mass: {com.tolist()}, expected three finite numbers, base frame [m]")
        straight = robot.thigh_length + robot.shank_length
        knee = np.abs(robot.joint_limits[:, 2])
        same_side = np.sign(robot.joint_limits[:, 2, 0]) == np.sign(robot.joint_limits[:, 2, 1])
        least = np.where(same_side, knee.min(axis=1), 0.0)
        side = np.where(robot.knee_sign < 0, -robot.joint_limits[:, 2, 0], robot.joint_limits[:, 2, 1])
        most = np.minimum(side, math.pi)
        span = lambda bend: np.sqrt(  # noqa: E731
            robot.thigh_length**2 + robot.shank_length**2 + 2 * robot.thigh_length * robot.shank_length * np.cos(bend)
        )
        longest = np.minimum(LONGEST * straight, span(least + _KNEE_MARGIN))
        shortest = np.maximum(SHORTEST * straight, span(most - _KNEE_MARGIN))
        size = float(straight.max())
        return cls(
            robot.hips - com, robot.abduction_offset, robot.thigh_length, robot.shank_length, robot.knee_sign,
            np.minimum(shortest, 0.95 * longest), longest, span(least), size, 0.06 * size,
        )  # fmt: skip
