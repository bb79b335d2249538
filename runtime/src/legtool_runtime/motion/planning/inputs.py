"""What a plan is asked for with, checked in compiled code: it is asked for often, and NumPy's calls take their time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.checks import ROTATION_TOLERANCE

Array = NDArray[np.float64]

FINE, POSITION, ROTATION, NO_ROTATION, OFF_MAP = range(5)


@kernel
def fault(position: Array, rotation: Array, distance: NDArray[np.float32], corner: Array, resolution: float) -> int:
    """What is wrong with a position (3,) and a rotation (3, 3), given the map's distances, lower corner and resolution.

    Returns:
        FINE; POSITION or ROTATION holds a value that is not finite; NO_ROTATION; OFF_MAP.
    """
    for i in range(3):
        if not np.isfinite(position[i]):
            return POSITION
    for i in range(3):
        for j in range(3):
            if not np.isfinite(rotation[i, j]):
                return ROTATION
    for i in range(3):
        for j in range(3):
            product = 0.0
            for k in range(3):
                product += rotation[i, k] * rotation[j, k]
            if abs(product - (1.0 if i == j else 0.0)) > ROTATION_TOLERANCE:
                return NO_ROTATION
    determinant = 0.0
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        determinant += rotation[0, k] * (rotation[1, a] * rotation[2, b] - rotation[1, b] * rotation[2, a])
    if determinant < 0.0:
        return NO_ROTATION
    for axis in range(2):
        if not 0.0 <= (position[axis] - corner[axis]) / resolution < distance.shape[axis]:
            return OFF_MAP
    return FINE


@kernel
def unevenness(feet: Array, rotation: Array) -> float:
    """Height of the highest of the feet (4, 3), base frame, over the lowest [m]."""
    low, high = np.inf, -np.inf
    for leg in range(4):
        height = 0.0
        for i in range(3):
            height += feet[leg, i] * rotation[2, i]
        low, high = min(low, height), max(high, height)
    return high - low
