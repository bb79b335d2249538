"""What the foothold search is to lead to: a place on the torso's path, and a heading where the path turns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.search.settings import PipsSettings
from legtool_runtime.search.torso import TorsoPath

Doubles = NDArray[np.float64]

#: The tolerance of a waypoint is at most such a share of the way to it, and at the goal of the goal's own.
_NEAR = 0.7
#: A path turns if half of its poses head so far off the robot's heading, to one side; the robot then is to turn by at
#: most so much, to within so much, before it goes on [rad].
_TURNED, _TURN, _TURN_WITHIN = 0.5, math.pi / 4, math.pi / 8
#: A goal is looked at where no ground leads nearer to it and its direction is so far off the heading [rad].
_ASIDE = 0.5
#: A way that is to be walked without a look at the goal leads nearer to it by such a share of its length at least.
_NEARER = 0.7
#: How far along the path it may get meanwhile [m].
_TURN_WAY_M = 0.8


@dataclass(frozen=True, eq=False)
class Aim:
    """An aim of the foothold search.

    Attributes:
        waypoint: (4,) x, y, z of the base [m], yaw [rad], world frame.
        yaw: that the base is to head to [rad]; None: any.
        tolerance: of the place [m].
        yaw_tolerance: of the heading [rad].
        ends: whether it is the goal.
    """

    waypoint: Doubles
    yaw: float | None
    tolerance: float
    yaw_tolerance: float
    ends: bool


def aim_along(path: TorsoPath, share: float, *, goal: ArrayLike, goal_yaw: float | None, settings: PipsSettings) -> Aim:
    """The farthest place along a path within a share of its length, or of what the search looks ahead.

    Args:
        path: of the torso, two poses or more.
        share: of it, 0 to 1.
        goal: (2,) world frame [m], which counts in the place of the path's end where the path reaches it.
        goal_yaw: wanted there [rad]; None: any.
        settings: of the searches.
    """
    waypoint = path.waypoint(max(share * min(path.length_m, settings.torso.reach), settings.torso.least_way)).copy()
    ends = path.status == "reached" and bool(np.allclose(waypoint, path.poses[-1]))
    if ends:
        waypoint[:2] = goal
    far = settings.goal_tolerance if ends else float(np.hypot(*(waypoint[:2] - path.poses[0, :2])))
    tolerance = min(settings.feet.tolerance, _NEAR * far)
    return Aim(waypoint, goal_yaw if ends else None, tolerance, settings.feet.yaw_tolerance, ends)


def turn_along(path: TorsoPath, settings: PipsSettings) -> Aim | None:
    """The first part of a turn that a path makes and keeps to; None where it makes none.

    A place alone leaves the search to find out that feet lead on only after a turn: as between two beams that only a
    robot astride can walk along.

    Args:
        path: of the torso; its first pose is the robot's.
        settings: of the searches.
    """
    off = np.remainder(path.poses[:, 3] - path.poses[0, 3] + math.pi, 2.0 * math.pi) - math.pi
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path.poses[:, :2], axis=0).T))])
    turned = float(np.median(off[1:])) if len(off) > 1 else 0.0
    if abs(turned) < _TURNED:
        return None
    side = math.copysign(1.0, turned)
    there = np.flatnonzero((side * off >= min(abs(turned), _TURN) - 1e-6) & (np.arange(len(off)) > 0))
    k = int(min(there[0], max(np.searchsorted(way, _TURN_WAY_M, side="right") - 1, 1)))
    waypoint = path.poses[k].copy()
    waypoint[3] = path.poses[0, 3] + side * min(abs(turned), _TURN)
    return Aim(waypoint, float(waypoint[3]), settings.feet.tolerance, _TURN_WITHIN, False)


def leads_out_of_sight(path: TorsoPath, goal: ArrayLike, settings: PipsSettings) -> bool:
    """Whether a path to the end of known ground is worse than a look at the goal, which lies beyond the camera's view.

    It is where the goal is so near that a look is enough to know the rest of the way, where the path's end lies aside,
    too, so that the robot would walk sideways into what it has not seen, and where the path leads little nearer.

    Args:
        path: of the torso; its first pose is the robot's.
        goal: (2,) world frame [m].
        settings: of the searches.
    """
    if settings.sight is None or path.status != "frontier":
        return False
    here, end = path.poses[0], path.poses[-1]
    to_goal, to_end = np.asarray(goal, dtype=np.float64)[:2] - here[:2], end[:2] - here[:2]
    if _off(to_goal, here[3]) <= settings.sight:
        return False
    far = float(np.hypot(*to_goal))
    gained = far - float(np.hypot(*(to_goal - to_end)))
    near = far <= settings.torso.reach
    return near or _off(to_end, here[3]) > settings.sight or gained < _NEARER * path.length_m


def _off(way: Doubles, yaw: float) -> float:
    """Angle between a way (2,) and a heading, without sign [rad]."""
    return abs(math.remainder(math.atan2(way[1], way[0]) - yaw, 2.0 * math.pi))


def look_at(goal: ArrayLike, path: TorsoPath, settings: PipsSettings) -> Aim | None:
    """A turn on the spot towards a goal, for a robot that knows no ground which leads nearer to it; None where it faces
    the goal: its camera may see more there.

    Args:
        goal: (2,) world frame [m].
        path: of the torso; its first pose is the robot's.
        settings: of the searches.
    """
    here = path.poses[0]
    x, y = np.asarray(goal, dtype=np.float64)[:2] - here[:2]
    off = math.remainder(math.atan2(y, x) - here[3], 2.0 * math.pi)
    if abs(off) < _ASIDE:
        return None
    waypoint = here.copy()
    waypoint[3] += math.copysign(min(abs(off), _TURN), off)
    return Aim(waypoint, float(waypoint[3]), settings.feet.tolerance, _TURN_WITHIN, False)
