"""From a path of stances to the contact plan that the tracker walks, and the part of a plan that is kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from legtool_runtime.robot import Robot
from legtool_runtime.search.feet import FootPlan
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance
from legtool_runtime.tracking.gaits import GaitTiming

#: A foothold may be given up for another one that is so near [m], see :mod:`legtool_runtime.tracking.reassign`.
_MOVABLE_M = 0.3


@dataclass(frozen=True, eq=False)
class Committed:
    """The part of a plan that is no longer changed.

    Attributes:
        plan: with each leg on the stance that its last swing leads to, for good.
        ready_s: from then on feet may lift again, on the plan's clock.
        swung: legs that swing last; None where none has.
    """

    plan: ContactPlan
    ready_s: float
    swung: tuple[int, ...] | None


def timing_of(gait: str, size: float = 1.0) -> GaitTiming:
    """Durations of a gait of :data:`~legtool_runtime.search.settings.GAITS`; acyclic ones take their time.

    Legs of a robot that is ``size`` times as large as ANYmal C swing as pendulums do: durations go with √size, so that
    the Froude number of a stride that is as long for its size stays the same.
    """
    timing = GaitTiming.trot() if gait == "trot" else GaitTiming.crawl()
    return timing.slower(math.sqrt(size))


def contact_plan(
    path: FootPlan,
    *,
    start_s: float,
    timing: GaitTiming | None = None,
    size: float = 1.0,
    before: ContactPlan | None = None,
    robot: Robot | None = None,
) -> ContactPlan:
    """The plan that walks a path of stances.

    Feet that a transition moves swing together; a foot that keeps its candidate stays in stance, and a transition that
    moves none takes no time. Swing heights are the tracker's.

    Args:
        path: of the foothold search.
        start_s: when the first feet lift.
        timing: of swings and full stances; None: by the path's gait, for a robot of this size.
        size: of the robot, see :func:`timing_of`.
        before: what is walked until then; each leg's last stance is the one that it stands in at the path's start.
        robot: whose legs must reach; None leaves that unchecked.

    Raises:
        TrackingError: a plan that the tracker could not walk.
    """
    pace = timing or timing_of(path.gait, size)
    if before is None:
        rows = [[Stance(-math.inf, math.inf, path.positions[0, leg], path.normals[0, leg])] for leg in range(4)]
    else:
        rows = [list(row) for row in before.stances]
    lift = start_s
    for k, stays in enumerate(path.families):
        if stays.all():
            continue
        for leg in np.flatnonzero(~stays).tolist():
            rows[leg][-1] = replace(rows[leg][-1], end_s=lift)
            place, normal = path.positions[k + 1, leg], path.normals[k + 1, leg]
            rows[leg].append(Stance(lift + pace.swing_s, math.inf, place, normal, _MOVABLE_M))
        lift += pace.step_s
    return ContactPlan(rows, robot=robot)


def committed(plan: ContactPlan, until_s: float, full_stance_s: float) -> Committed:
    """What touchdowns before an instant is walked to its touchdown; what was to lift later stays on the ground.

    Args:
        plan: that is walked now.
        until_s: no lift-off from then on is kept.
        full_stance_s: between the last touchdown and the next lift-off.
    """
    rows: list[list[Stance]] = []
    landed, touchdowns = -math.inf, np.full(4, -math.inf)
    for leg, row in enumerate(plan.stances):
        last = next((k for k, s in enumerate(row) if s.end_s >= until_s), len(row) - 1)
        rows.append([*row[:last], replace(row[last], end_s=math.inf)])
        if math.isfinite(row[last].begin_s):
            landed, touchdowns[leg] = max(landed, row[last].begin_s), row[last].begin_s
    swung = float(touchdowns.max())
    legs = tuple(np.flatnonzero(touchdowns >= swung - 1e-3).tolist()) if math.isfinite(swung) else None
    return Committed(ContactPlan(rows), max(until_s, landed + full_stance_s), legs)


def remaining(plan: ContactPlan, after_s: float) -> list[Stance]:
    """Stances of all legs that begin after an instant, in order of time."""
    return sorted((s for row in plan.stances for s in row if s.begin_s > after_s), key=lambda s: s.begin_s)


def last_places(plan: ContactPlan) -> tuple[np.ndarray, np.ndarray]:
    """(4, 3) contact points and normals of the stances that a plan ends in."""
    ends: Sequence[Stance] = [row[-1] for row in plan.stances]
    return np.array([s.place for s in ends]), np.array([s.normal for s in ends])
