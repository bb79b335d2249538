"""Legs that stand as a constraint on the pose, in compiled code: none too straight, none too folded.

A leg's span, from its thigh axis to its foot, follows from the distance of hip and foot and from the abduction offset
alone: span² = |foot - hip|² - offset². So each standing leg bounds how far its hip may be from its foot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.errors import StateError
from legtool_runtime.legs import Legs

Array = NDArray[np.float64]

#: No leg stands.
FREE: Array = np.zeros((0, 8))
#: Weight of the square of what a leg is beyond its bounds [1/m²]: gains are below 1, so that little is traded for it.
PENALTY = 1e5
#: By how much a height beyond the bounds counts less on the grid of a search [1/m]: no gain is worth it.
_LAST = 1e9


def stands_of(
    legs: Legs,
    standing: ArrayLike,
    *,
    base_position: Sequence[float],
    yaw: float,
    base_twist: Sequence[float],
    reference: float,
    stretch: float,
    ahead_s: float,
) -> Array:
    """The bounds that standing legs set: now, and where the twist has carried the trunk a little later.

    Args:
        legs: of the robot, hips from the trunk's origin.
        standing: (4, 3) foot centres, world frame [m]; rows of legs that do not stand hold NaN.
        base_position: (2,) or (3,) x, y of the trunk, world frame [m].
        yaw: of the trunk [rad].
        base_twist: (6,) horizontal frame [m/s, rad/s]; forward, left and yaw count, for height and tilt are sought.
        reference: height that poses are measured above, world frame [m].
        stretch: share of the longest span that the knee allows.
        ahead_s: how much later [s].

    Returns:
        (m, 8), a row for each standing leg and instant: hip (3,) from the trunk's origin, foot (3,) in the horizontal
        frame below that origin and above the reference, shortest and longest distance of the two [m].

    Raises:
        StateError: feet of another shape, or infinite.
    """
    feet = np.asarray(standing, dtype=np.float64)
    if feet.shape != (4, 3) or np.isinf(feet).any():
        raise StateError(f"standing feet {feet.tolist()}: expected (4, 3) in metres, NaN for legs that do not stand")
    rows = []
    for later in (0.0, ahead_s):
        half = yaw + 0.5 * base_twist[5] * later
        x = base_position[0] + (math.cos(half) * base_twist[0] - math.sin(half) * base_twist[1]) * later
        y = base_position[1] + (math.sin(half) * base_twist[0] + math.cos(half) * base_twist[1]) * later
        c, s = math.cos(yaw + base_twist[5] * later), math.sin(yaw + base_twist[5] * later)
        for leg in np.flatnonzero(~np.isnan(feet).any(axis=1)):
            dx, dy, dz = feet[leg, 0] - x, feet[leg, 1] - y, feet[leg, 2] - reference
            bounds = np.hypot([legs.shortest[leg], stretch * legs.reach[leg]], legs.offset[leg])
            rows.append([*legs.hips[leg], c * dx + s * dy, c * dy - s * dx, dz, *bounds])
    return np.array(rows, dtype=np.float64).reshape(-1, 8)


@kernel
def _hip(stand: Array, sb: float, cb: float, sg: float, cg: float) -> tuple[float, float, float]:
    """A hip from the trunk's origin, horizontal frame [m]; sines and cosines of roll and pitch."""
    lifted = stand[1] * sb + stand[2] * cb
    return cg * stand[0] + sg * lifted, cb * stand[1] - sb * stand[2], cg * lifted - sg * stand[0]


@kernel
def beyond_stands(stands: Array, pose: Array) -> float:
    """Sum of the squares of what legs are beyond their bounds at a pose (3,): height, roll, pitch [m²]."""
    sb, cb, sg, cg = np.sin(pose[1]), np.cos(pose[1]), np.sin(pose[2]), np.cos(pose[2])
    total = 0.0
    for n in range(stands.shape[0]):
        x, y, z = _hip(stands[n], sb, cb, sg, cg)
        way = np.sqrt((x - stands[n, 3]) ** 2 + (y - stands[n, 4]) ** 2 + (pose[0] + z - stands[n, 5]) ** 2)
        beyond = way - min(max(way, stands[n, 6]), stands[n, 7])
        total += beyond * beyond
    return total


@kernel
def model_stands(stands: Array, pose: Array, gradient: Array, matrix: Array) -> float:
    """The penalty at a pose (3,); adds its slope to the ``gradient`` (3,) and ``matrix`` (3, 3) of a gain.

    The matrix is Gauss and Newton's, its lower half: see ``pose_search._model``.
    """
    sb, cb, sg, cg = np.sin(pose[1]), np.cos(pose[1]), np.sin(pose[2]), np.cos(pose[2])
    total, slope = 0.0, np.empty(3)
    for n in range(stands.shape[0]):
        x, y, z = _hip(stands[n], sb, cb, sg, cg)
        dx, dy, dz = x - stands[n, 3], y - stands[n, 4], pose[0] + z - stands[n, 5]
        way = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-6)
        beyond = way - min(max(way, stands[n, 6]), stands[n, 7])
        if beyond == 0.0:
            continue
        total += PENALTY * beyond * beyond
        lifted, aside = stands[n, 1] * sb + stands[n, 2] * cb, stands[n, 1] * cb - stands[n, 2] * sb
        slope[0] = dz / way
        slope[1] = (dx * sg * aside - dy * lifted + dz * cg * aside) / way
        slope[2] = (dx * z - dz * x) / way
        for k in range(3):
            gradient[k] -= 2.0 * PENALTY * beyond * slope[k]
            for i in range(k + 1):
                matrix[k, i] += 2.0 * PENALTY * slope[k] * slope[i]
    return total


@kernel
def lower_column(stands: Array, roll: float, pitch: float, low: float, step: float, column: Array) -> None:
    """Lower the scores ``column`` (n,) of heights ``low`` + k ``step`` where they are more than half a step out."""
    sb, cb, sg, cg = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    least, most = -np.inf, np.inf
    for n in range(stands.shape[0]):
        x, y, z = _hip(stands[n], sb, cb, sg, cg)
        aside = (x - stands[n, 3]) ** 2 + (y - stands[n, 4]) ** 2
        foot, near, far = stands[n, 5] - z, stands[n, 6] ** 2 - aside, stands[n, 7] ** 2 - aside
        most = min(most, foot + np.sqrt(max(far, 0.0)))
        if near > 0.0:
            least = max(least, foot + np.sqrt(near))
    for k in range(column.shape[0]):
        height = low + k * step
        column[k] -= _LAST * max(max(least - height, height - most) - 0.5 * step, 0.0)
