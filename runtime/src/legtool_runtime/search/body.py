"""The robot for compiled code: whether its legs reach four feet at a pose, and what legs and trunk clear there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.errors import PlannerError
from legtool_runtime.legs import Legs
from legtool_runtime.robot import Robot, leg_forward, leg_inverse
from legtool_runtime.tracking.ground import Ground, height_at, lowest_centre

Doubles = NDArray[np.float64]

#: Share of the slope of the feet's plane that the body tilts by: as the tracker's reference does.
TILT = 0.8
#: Kept from joint limits [rad].
_JOINT_MARGIN = 0.05
#: A foot stands at least so far below its hip, as share of the leg's length.
_BELOW = 0.15
#: A body whose legs are too short where it is nominally is lowered by so much, so many times; shares of the leg.
_LOWER, _LOWERINGS = 0.05, 3
#: Depth of the belly under the base, as share of the leg's length; half of the trunk's length over the hips' distance.
_BELLY, _LONG = 0.16, 0.9
#: Points on the shank that must clear the ground, as shares of the way from foot to knee.
_SHANK = 5


class Body(NamedTuple):
    """A robot: its legs, joint limits (4, 3, 2), foot radius, height of its base over the feet's centres, trunk."""

    legs: Legs
    limits: Doubles
    radius: float
    height: float
    belly: float
    half_length: float


class Scratch(NamedTuple):
    """Memory of one stance: rotation (3, 3); feet, feet in the base frame, angles (4, 3); pose (6,); a point (3,);
    weights of the feet (4,)."""

    rotation: Doubles
    feet: Doubles
    inside: Doubles
    angles: Doubles
    pose: Doubles
    point: Doubles
    weights: Doubles


def body_of(robot: Robot, *, height_m: float | None = None, com_offset: ArrayLike = (0.0, 0.0, 0.0)) -> Body:
    """The body of a robot whose base is held so high over the ground, with its centre of mass over the feet.

    Raises:
        PlannerError: a height that the legs do not reach.
        TrackingError: a centre of mass that is not three finite numbers.
    """
    legs = Legs.of(robot, com_offset)
    height = robot.standing_height if height_m is None else float(height_m)
    if not 0.3 * legs.size < height < 1.5 * legs.size:
        raise PlannerError(f"body height {height} m, expected {0.3 * legs.size:.2f} to {1.5 * legs.size:.2f}")
    above = height - robot.foot_radius + float(np.asarray(com_offset, dtype=np.float64)[2])
    half = _LONG * float(robot.hips[:, 0].max() - robot.hips[:, 0].min()) / 2.0
    return Body(legs, np.ascontiguousarray(robot.joint_limits), robot.foot_radius, above, _BELLY * legs.size, half)


def trunk_width(robot: Robot) -> float:
    """Width of the trunk, from its hips [m]."""
    return 1.35 * float(robot.hips[:, 1].max() - robot.hips[:, 1].min())


def scratch() -> Scratch:
    """Memory for one stance."""
    return Scratch(
        np.empty((3, 3)), np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 3)), np.empty(6), np.empty(3), np.ones(4)
    )


@kernel
def rotation_into(pose: Doubles, out: Doubles) -> None:
    """Write the rotation (3, 3) body to world of a pose (6,) with roll, pitch and yaw: yaw, then pitch, then roll."""
    cr, sr, cp, sp = np.cos(pose[3]), np.sin(pose[3]), np.cos(pose[4]), np.sin(pose[4])
    cy, sy = np.cos(pose[5]), np.sin(pose[5])
    out[0, 0], out[0, 1], out[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    out[1, 0], out[1, 1], out[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    out[2, 0], out[2, 1], out[2, 2] = -sp, cp * sr, cp * cr


@kernel
def leg_fits(body: Body, leg: int, s: Scratch) -> int:
    """Whether a leg reaches ``s.feet[leg]`` at ``s.pose``, whose rotation is ``s.rotation``: 0; 1: it is too short;
    2: folded too far, beyond a joint's limit, or with the foot too high. Writes the foot in the base frame and the
    joint angles."""
    legs, inside, angles = body.legs, s.inside[leg], s.angles[leg]
    dx, dy, dz = s.feet[leg, 0] - s.pose[0], s.feet[leg, 1] - s.pose[1], s.feet[leg, 2] - s.pose[2]
    for i in range(3):
        inside[i] = s.rotation[0, i] * dx + s.rotation[1, i] * dy + s.rotation[2, i] * dz
    x, y, z = inside[0] - legs.hips[leg, 0], inside[1] - legs.hips[leg, 1], inside[2] - legs.hips[leg, 2]
    if z > -_BELOW * legs.size:
        return 2
    span = np.sqrt(x * x + max(y * y + z * z - legs.offset[leg] ** 2, 1e-8))
    if span > legs.longest[leg]:
        return 1
    if span < legs.shortest[leg]:
        return 2
    if not leg_inverse(
        legs.hips[leg], legs.offset[leg], legs.thigh[leg], legs.shank[leg], legs.sign[leg], inside, angles
    ):
        return 2
    for joint in range(3):
        low, high = body.limits[leg, joint, 0], body.limits[leg, joint, 1]
        turns = np.round((angles[joint] - 0.5 * (low + high)) / (2.0 * np.pi))
        angle = angles[joint] - 2.0 * np.pi * turns
        if angle < low + _JOINT_MARGIN or angle > high - _JOINT_MARGIN:
            return 2
    return 0


@kernel
def legs_fit(body: Body, standing: NDArray[np.bool_], s: Scratch) -> bool:
    """Whether legs reach their feet at ``s.pose``, or at a lower one, which it becomes."""
    rotation_into(s.pose, s.rotation)
    lowered = 0
    while True:
        worst = 0
        for leg in range(4):
            if standing[leg]:
                worst = max(worst, leg_fits(body, leg, s))
                if worst:
                    break
        if worst == 0:
            return True
        if worst == 2 or lowered >= _LOWERINGS:
            return False
        lowered += 1
        s.pose[2] -= _LOWER * body.legs.size


@kernel
def shanks_clear(body: Body, ground: Ground, trunk: Ground, clearance: float, s: Scratch) -> bool:
    """Whether all shanks, at the angles and feet that :func:`leg_fits` wrote, are so far from the ground on all sides.

    ``trunk`` holds for each cell the highest ground within the trunk's half-width: a quick look.
    """
    legs = body.legs
    for leg in range(4):
        leg_forward(legs.hips[leg], legs.offset[leg], legs.thigh[leg], 0.0, s.angles[leg], s.point)
        for k in range(1, _SHANK + 1):
            share = k / _SHANK
            x = s.inside[leg, 0] + share * (s.point[0] - s.inside[leg, 0])
            y = s.inside[leg, 1] + share * (s.point[1] - s.inside[leg, 1])
            z = s.inside[leg, 2] + share * (s.point[2] - s.inside[leg, 2])
            place_x = s.pose[0] + s.rotation[0, 0] * x + s.rotation[0, 1] * y + s.rotation[0, 2] * z
            place_y = s.pose[1] + s.rotation[1, 0] * x + s.rotation[1, 1] * y + s.rotation[1, 2] * z
            above = s.pose[2] + s.rotation[2, 0] * x + s.rotation[2, 1] * y + s.rotation[2, 2] * z
            if height_at(trunk, place_x, place_y) + clearance <= above:
                continue
            if lowest_centre(ground, place_x, place_y, clearance, True) > above:  # never where the ground is unknown
                return False
    return True


@kernel
def trunk_clears(
    trunk: Ground, place: tuple[float, float, float], yaw: float, half_length: float, clearance: float
) -> bool:
    """Whether a trunk whose belly's middle is at a place clears what is known under it.

    ``trunk`` holds for each cell the highest ground within the trunk's half-width.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    for k in range(5):
        along = half_length * (0.5 * k - 1.0)
        if place[2] < height_at(trunk, place[0] + c * along, place[1] + s * along) + clearance:
            return False
    return True
