"""Another foothold for a foot in the air while the body is off its way (QuadPiPS, section VII-B)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.legs import Legs
from legtool_runtime.robot import Robot
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.stance_check import stance_fault

Array = NDArray[np.float64]

#: A foot goes to another place on about its level only, and if that is so much nearer to where it would catch the body,
#: which is so far from the planned one at most; for ANYmal C [m].
_LEVEL_M, _LEAST_M, _FARTHEST_M = 0.06, 0.02, 0.20
#: Places that are tried for each foot, the nearest first.
_TRIED = 3


class Footholds(NamedTuple):
    """Where feet may stand: contact points and normals (n, 3), world frame [m]."""

    points: Array
    normals: Array


def reassigned(
    plan: ContactPlan,
    clock_s: float,
    off: Array,
    *,
    omega: float,
    legs: Sequence[int],
    footholds: Footholds,
    robot: Robot,
    size: float = 1.0,
) -> ContactPlan | None:
    """The plan with feet in the air going to other places; None where none is better.

    A body whose ξ = c + v/ω is off its reference by ``off`` is off by ``off · exp(ω t)`` when a foot lands in t: so far
    from its planned place the foot keeps the body over its feet as planned (the capture point's rule).

    Args:
        plan: that is walked; no foot goes farther than its stance may move (``Stance.movable_m``).
        clock_s: now, on its clock.
        off: (2,) of ξ off its reference, world frame [m].
        omega: ω = √(g/h) [1/s].
        legs: that swing.
        footholds: that are admissible.
        robot: whose legs must reach.
        size: that lengths are scaled by; 1 for ANYmal C.
    """
    model, changed = Legs.of(robot), None
    for leg in legs:
        now = changed or plan
        k = now.neighbour(leg, clock_s)
        stance = now.stances[leg][k]
        left_s = stance.begin_s - clock_s
        if not 0.0 < left_s < math.inf:
            continue
        shift = off * math.exp(omega * left_s)
        shift *= min(1.0, _FARTHEST_M * size / max(float(np.hypot(*shift)), 1e-9))
        way = footholds.points - stance.place
        near = (np.linalg.norm(way, axis=1) <= stance.movable_m) & (np.abs(way[:, 2]) <= _LEVEL_M * size)
        missed = np.where(near, np.hypot(*(way[:, :2] - shift).T), np.inf)
        for row in np.argsort(missed)[:_TRIED].tolist():
            if not missed[row] <= float(np.hypot(*shift)) - _LEAST_M * size:
                break
            better = now.moved(leg, k, footholds.points[row], footholds.normals[row])
            places = np.array([s[better.neighbour(i, stance.begin_s)].place for i, s in enumerate(better.stances)])
            standing = better.standing(stance.begin_s)
            standing[leg] = True
            if not stance_fault(robot, model, places, standing, leg):
                changed = better
                break
    return changed
