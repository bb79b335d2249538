"""Whether a torso pose stands over ground: the support predicate of torso search and cost-to-go field (VI-B)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.robot import Robot
from legtool_runtime.search.body import Body
from legtool_runtime.search.candidates import Candidates
from legtool_runtime.search.settings import TorsoSettings
from legtool_runtime.tracking.ground import Ground, height_at

Doubles = NDArray[np.float64]

#: Headings of torso poses, π/8 apart.
YAWS = 16
#: Cells in which supports are kept [m].
_CELL = 0.06
#: Places along the trunk that are held against the ground, as shares of its half-length.
_TRUNK = (-0.7, 0.0, 0.7)
#: Where no support is asked for, ground this near carries a pose: the release's edges of 0.6 m leap as far [m].
_LEAP_M = 0.3
#: Steepest torso, as a rise over a way: more than legs allow, since supports lie some way off the feet.
_SLOPE = 0.75
#: Where a torso stands over no ground.
NOWHERE = -np.inf


class Supports(NamedTuple):
    """``height`` (n, n) of the nearest candidate within a radius of each cell's centre [m], NaN where there is none;
    ``assumed`` (n, n) whether that ground is; ``low`` (2,) cell indices of the lower corner; ``cell`` [m]; ``stance``
    (16, 4, 2) ideal feet around the torso by heading, a single one in its middle where no support is asked for [m];
    ``along`` (16, 3, 2) places under the trunk; heights ``above`` the ground and of the ``belly`` below the base."""

    height: Doubles
    assumed: NDArray[np.bool_]
    low: NDArray[np.int64]
    cell: float
    stance: Doubles
    along: Doubles
    trunk: Ground
    above: float
    belly: float
    uneven: float
    clearance: float


def supports_of(
    candidates: Candidates,
    body: Body,
    robot: Robot,
    settings: TorsoSettings,
    *,
    width: float,
    trunk: Ground,
    middle: ArrayLike,
) -> Supports:
    """What carries torso poses around a place.

    Args:
        candidates: footholds.
        body: of the robot.
        robot: whose stance at rest gives the ideal length.
        settings: of the torso search.
        width: ideal distance of left and right feet [m].
        trunk: ground that the trunk must clear.
        middle: (2,) of the window, world frame [m].
    """
    free = settings.support == 0.0
    stance = np.zeros((1, 2)) if free else robot.stance[:, :2].copy()
    if not free:
        stance[:, 1] = 0.5 * width * np.array([1.0, -1.0, 1.0, -1.0])
    radius = _LEAP_M if free else settings.support
    half = settings.reach + 0.35 + float(np.hypot(*stance.T).max()) + radius
    n = 2 * int(np.ceil(half / _CELL)) + 1
    low = np.floor(np.asarray(middle, dtype=np.float64) / _CELL).astype(np.int64) - n // 2
    height, assumed = np.full((n, n), np.nan), np.zeros((n, n), dtype=np.bool_)
    _spread(candidates.points, candidates.assumed, radius, low, height, assumed)
    yaws = np.array([yaw_of(k) for k in range(YAWS)])
    turns = np.stack([np.cos(yaws), np.sin(yaws), -np.sin(yaws), np.cos(yaws)], axis=1).reshape(YAWS, 2, 2)
    trunk_places = body.half_length * np.array([[share, 0.0] for share in _TRUNK])
    return Supports(
        height, assumed, low, _CELL, np.ascontiguousarray(stance @ turns), np.ascontiguousarray(trunk_places @ turns),
        trunk, body.height + body.radius, body.belly, np.inf if free else settings.uneven,
        -10.0 if free else settings.clearance,
    )  # fmt: skip


@kernel
def yaw_of(k: int) -> float:
    """The heading of a number [rad]: -π for 0, and counter-clockwise."""
    return -np.pi + k * (2.0 * np.pi / YAWS)


@kernel
def nearest_yaw(yaw: float) -> int:
    """The number of the heading nearest to one [rad]."""
    return int(np.round((yaw + np.pi) / (2.0 * np.pi / YAWS))) % YAWS


@kernel
def _spread(
    points: Doubles,
    assumed: NDArray[np.bool_],
    radius: float,
    low: NDArray[np.int64],
    height: Doubles,
    out: NDArray[np.bool_],
) -> None:
    """Write for each cell the nearest candidate's height, within a radius of its centre."""
    n, reach = height.shape[0], int(np.ceil(radius / _CELL))
    nearest = np.full((n, n), radius * radius)
    for c in range(points.shape[0]):
        fx, fy = points[c, 0] / _CELL - low[0] - 0.5, points[c, 1] / _CELL - low[1] - 0.5
        i, j = int(np.floor(fx + 0.5)), int(np.floor(fy + 0.5))
        for p in range(max(i - reach, 0), min(i + reach + 1, n)):
            for q in range(max(j - reach, 0), min(j + reach + 1, n)):
                square = ((p - fx) ** 2 + (q - fy) ** 2) * _CELL * _CELL
                if square <= nearest[p, q]:
                    nearest[p, q], height[p, q], out[p, q] = square, points[c, 2], assumed[c]


@kernel
def torso_height(s: Supports, x: float, y: float, k: int) -> tuple[float, float]:
    """Height of a supported torso's base at a place with a numbered heading, NOWHERE if it is not supported; and how
    much of its support is assumed, 0 to 1."""
    n, feet = s.height.shape[0], s.stance.shape[1]
    total, twist, slope, lean, unseen = 0.0, 0.0, 0.0, 0.0, 0.0
    for leg in range(feet):
        i = int(np.floor((x + s.stance[k, leg, 0]) / s.cell)) - s.low[0]
        j = int(np.floor((y + s.stance[k, leg, 1]) / s.cell)) - s.low[1]
        if not (0 <= i < n and 0 <= j < n):
            return NOWHERE, 0.0
        z = s.height[i, j]
        if np.isnan(z):
            return NOWHERE, 0.0
        front, left = 1.0 if leg < 2 else -1.0, 1.0 if leg in (0, 2) else -1.0
        total, twist, slope, lean = total + z, twist + front * left * z, slope + front * z, lean + left * z
        unseen += s.assumed[i, j]
    if feet == 4:
        steep = 4.0 * _SLOPE
        if (
            abs(twist) > 4.0 * s.uneven
            or abs(slope) > steep * abs(s.stance[YAWS // 2, 0, 0])
            or abs(lean) > steep * abs(s.stance[YAWS // 2, 0, 1])
        ):
            return NOWHERE, 0.0
    z = total / feet + s.above
    for point in range(len(_TRUNK)):
        top = height_at(s.trunk, x + s.along[k, point, 0], y + s.along[k, point, 1])
        if z - s.belly < top + s.clearance:  # never where the ground is unknown
            return NOWHERE, 0.0
    return z, unseen / feet
