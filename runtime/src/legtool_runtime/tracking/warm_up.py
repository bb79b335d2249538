"""Compile or load all that tracking calls, before the first tick counts."""

from __future__ import annotations

import numpy as np

from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.dynamics import GRAVITY
from legtool_runtime.tracking.gait_tracker import GaitTracker, Guidance
from legtool_runtime.tracking.gaits import GaitTiming, plan_from_gait
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.selectors import any_place
from legtool_runtime.tracking.touchdown import Touchdowns
from legtool_runtime.tracking.tracker import MeasuredState, Tracker

#: Ticks and how long each is [s]: a lift-off, a swing, and its touchdown, which is late.
_TICKS, _LATE_TICKS, _TICK_S = 40, 30, 0.0025
_CELL_M, _CELLS = 0.05, 60
#: Until a gait has lifted its first feet and chosen again in mid-swing.
_GAIT_TICKS = 220


def warm_up(robot: TrackedRobot) -> None:
    """Track a short step of a robot at rest, with a map and without: some ten milliseconds where all is compiled.

    Without it the first ticks of a walk compile whole-body control, body reference and preview, which takes seconds, or
    load them, which takes tenths.

    Args:
        robot: that will walk; kernels are the same for all robots.
    """
    geometry = robot.geometry
    places = geometry.stance + np.array([0.0, 0.0, -float(geometry.stance[:, 2].min())])
    footholds = [np.stack([place, place]) for place in places]
    timing = GaitTiming(swing_s=0.5 * _TICKS * _TICK_S)
    state = _at_rest(robot)
    swinging = np.isin(np.arange(4), timing.groups[0])
    in_air = state._replace(forces=np.where(swinging, 0.0, state.forces))
    for elevation in (None, _flat()):
        tracker = Tracker(robot, plan_from_gait(timing, footholds, start_s=_TICK_S), elevation=elevation)
        for tick in range(_TICKS):
            tracker.step(in_air if tick < _LATE_TICKS else state, tick * _TICK_S)
    # Feet that land at their footholds do not ask the map.
    Touchdowns(weight=1.0, radius=0.02).lands(0, phase=1.0, force=1.0, foot=np.zeros(3), elevation=_flat())


def warm_up_gait(robot: TrackedRobot) -> None:
    """The same for :class:`.GaitTracker`, with a pose and a map: a robot at rest lifts its first feet.

    Selectors by the foothold criteria are warmed up by :meth:`.Criteria.warm_up`.

    Args:
        robot: that will walk.
    """
    warm_up(robot)
    gait, state, flat = GaitTracker(robot, GaitTiming()), _at_rest(robot), _flat()
    pose = np.array([robot.geometry.standing_height, 0.0, 0.0])
    guidance = Guidance((0.1, 0.0, 0.0), any_place(flat), pose, flat)
    for tick in range(_GAIT_TICKS):
        gait.step(state, tick * _TICK_S, guidance)


def _at_rest(robot: TrackedRobot) -> MeasuredState:
    geometry = robot.geometry
    angles, _ = geometry.joints(geometry.stance)
    return MeasuredState(
        np.array([0.0, 0.0, geometry.standing_height]), np.array([1.0, 0.0, 0.0, 0.0]), angles, np.zeros(18),
        np.full(4, 0.25 * robot.mass * GRAVITY),
    )  # fmt: skip


def _flat() -> HeightMap:
    return HeightMap(np.zeros((_CELLS, _CELLS), np.float32), _CELL_M, np.zeros(2))
