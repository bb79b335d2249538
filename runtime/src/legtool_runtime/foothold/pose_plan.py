"""What pose optimisation gives: poses, and what they promise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pose:
    """A planned body pose.

    Attributes:
        height: of the trunk's origin, world frame [m].
        roll: β [rad].
        pitch: γ, positive is nose down [rad].
        safe: (4,) number of safe footholds per leg that the pose promises: F̂ at the hips.
        reference: height of the terrain that heights were measured above, world frame [m].
    """

    height: float
    roll: float
    pitch: float
    safe: Array
    reference: float


@dataclass(frozen=True, eq=False)
class PosePlan:
    """Poses of all horizons; the first is the one to take.

    Attributes:
        poses: one per horizon.
        weights: (h, 4, E) of the safe-foothold functions.
        objective: equation 23.
    """

    poses: tuple[Pose, ...]
    weights: Array
    objective: float
