"""Whether four feet can stand where a plan puts them at one instant: reach, joint limits, and feet that cross."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.robot import JOINTS, LEGS, Robot, leg_inverse
from legtool_runtime.tracking.ground import ground_of
from legtool_runtime.tracking.reach import Legs, fit_poses, leg_span, level_pose, to_body

Array = NDArray[np.float64]

#: Beyond this, a stance is refused: length of a leg [m], and angle of a joint [rad].
_BEYOND_M, _BEYOND_RAD = 0.01, 0.02
#: A foot stands at least so far below its hip, as share of the leg's length.
_BELOW = 0.15
#: Pairs of feet that must not cross: left of which foot the first stands (1), or ahead of which (0).
_SIDES = ((0, 1, 1), (2, 3, 1), (0, 2, 0), (1, 3, 0))
_STEPS, _STEP = 20, 1e-5


def stance_fault(robot: Robot, legs: Legs, places: Array, standing: NDArray[np.bool_], leg: int) -> str:
    """What is wrong with the place of a leg that comes to stand among the others; empty if nothing is.

    Args:
        robot: whose limits hold.
        legs: of this robot.
        places: (4, 3) contact points, of a swinging leg where it goes, world frame [m].
        standing: (4,) which of them stand.
        leg: that comes.

    Returns:
        words that go on from "FL, stance 2 at [...] m".
    """
    feet = places + np.array([0.0, 0.0, robot.foot_radius])
    pose = np.empty(6)
    level_pose(feet, np.ones(4), 0.8 * float(legs.longest.mean()) - float(legs.hips[:, 2].mean()), 0.8, pose)
    if fault := _crossing(feet, standing, leg, float(pose[5]), 2.0 * robot.foot_radius):
        return fault
    offsets = np.zeros((1, 5))
    fit_poses(legs, pose[None], feet[None], standing[None], ground_of(None), 0.0, offsets)
    pose[:5] += offsets[0]
    if (beyond := _out_of_reach(legs, feet, standing, pose)) > _BEYOND_M:
        return f"is out of reach by {100 * beyond:.0f} cm from where the other feet stand then; bring it nearer"
    excess = np.zeros(16)
    keep_joint_limits(legs, robot.joint_limits, feet, standing, pose, excess)
    worst = int(np.argmax(np.abs(excess[:12])))
    if (angle := abs(float(excess[worst]))) > _BEYOND_RAD:
        joint = f"{LEGS[worst // 3]} {JOINTS[worst % 3]}"
        return (
            f"turns {joint} beyond its limit by {angle:.2f} rad in the best pose that the other feet allow then; "
            "bring it nearer"
        )
    return ""


def _crossing(feet: Array, standing: NDArray[np.bool_], leg: int, yaw: float, least: float) -> str:
    """How a leg's foot crosses another one that stands, seen in the heading of all four; empty if it does not."""
    axes = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    for first, second, axis in _SIDES:
        if leg not in (first, second) or not (standing[first] and standing[second]):
            continue
        apart = float(axes[axis] @ (feet[first, :2] - feet[second, :2]))
        if apart < least:
            where = ("ahead of", "left of")[axis]
            return (
                f"crosses feet: {LEGS[first]} stands {100 * apart:.0f} cm {where} {LEGS[second]}, expected "
                f"{100 * least:.0f} cm or more; put it on its own side"
            )
    return ""


def _out_of_reach(legs: Legs, feet: Array, standing: NDArray[np.bool_], pose: Array) -> float:
    """By how much a standing leg is beyond its bounds at a pose [m]."""
    beyond, inside, slope = 0.0, np.empty(3), np.empty(5)
    for leg in np.flatnonzero(standing).tolist():
        span = leg_span(legs, leg, pose, feet[leg], slope)
        to_body(pose, feet[leg], inside)
        above = float(inside[2] - legs.hips[leg, 2]) + _BELOW * legs.size
        beyond = max(beyond, span - float(legs.longest[leg]), float(legs.shortest[leg]) - span, above)
    return beyond


@kernel
def _excess(legs: Legs, limits: Array, feet: Array, standing: NDArray[np.bool_], pose: Array, out: Array) -> float:
    """Write by how much joints are beyond their limits (12,) [rad] and legs beyond their bounds (4,), as shares of the
    leg's length; the sum of squares."""
    inside, angles, slope = np.empty(3), np.empty(3), np.empty(5)
    out[:] = 0.0
    for leg in range(4):
        if not standing[leg]:
            continue
        to_body(pose, feet[leg], inside)
        leg_inverse(
            legs.hips[leg], legs.offset[leg], legs.thigh[leg], legs.shank[leg], legs.sign[leg], inside, angles
        )  # fmt: skip
        for joint in range(3):
            low, high = limits[leg, joint, 0], limits[leg, joint, 1]
            turns = np.round((angles[joint] - 0.5 * (low + high)) / (2.0 * np.pi))
            angle = angles[joint] - 2.0 * np.pi * turns
            out[3 * leg + joint] = angle - min(max(angle, low), high)
        span = leg_span(legs, leg, pose, feet[leg], slope)
        out[12 + leg] = (span - min(max(span, legs.shortest[leg]), legs.longest[leg])) / legs.size
    return np.sum(out * out)


@kernel
def keep_joint_limits(
    legs: Legs, limits: Array, feet: Array, standing: NDArray[np.bool_], pose: Array, excess: Array
) -> float:
    """Move a pose (6,) but for its yaw so that standing legs keep their limits: Levenberg and Marquardt's steps.

    Args:
        legs: of the robot.
        limits: (4, 3, 2) of its joints [rad].
        feet: (4, 3) their centres, world frame [m].
        standing: (4,) whose limits bind.
        pose: to start from, and the answer: x, y, z of the centre of mass [m], roll, pitch, yaw [rad].
        excess: (16,) is written: what is left beyond joints' limits (12,) [rad] and legs' bounds (4,), as shares of
            the leg's length.

    Returns:
        the sum of its squares.
    """
    cost = _excess(legs, limits, feet, standing, pose, excess)
    slopes, trial, other, damping = np.empty((5, 16)), pose.copy(), np.empty(16), 1e-3
    for _ in range(_STEPS):
        if cost < 1e-8:
            break
        for i in range(5):
            trial[:] = pose
            trial[i] += _STEP
            _excess(legs, limits, feet, standing, trial, other)
            slopes[i] = (other - excess) / _STEP
        normal, gradient = slopes @ slopes.T, slopes @ excess
        better = False
        for _ in range(6):
            trial[:] = pose
            trial[:5] -= np.linalg.solve(normal + damping * np.eye(5), gradient)
            found = _excess(legs, limits, feet, standing, trial, other)
            if found < cost:
                better = True
                break
            damping *= 5.0
        if not better:
            break
        gained = cost - found
        pose[:], excess[:], cost = trial, other, found
        damping = max(0.2 * damping, 1e-6)
        if gained < 1e-3 * cost:
            break
    return cost
