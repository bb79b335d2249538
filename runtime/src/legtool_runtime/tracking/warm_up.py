"""Compile or load all that tracking calls, before the first tick counts."""

from __future__ import annotations

import numpy as np

from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.dynamics import GRAVITY
from legtool_runtime.tracking.gaits import GaitTiming, plan_from_gait
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.tracker import MeasuredState, Tracker

#: Ticks and how long each is [s]: a lift-off, a swing and its touchdown.
_TICKS, _TICK_S = 40, 0.0025
_CELL_M, _CELLS = 0.05, 60


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
    angles, _ = geometry.joints(geometry.stance)
    state = MeasuredState(
        np.array([0.0, 0.0, geometry.standing_height]), np.array([1.0, 0.0, 0.0, 0.0]), angles, np.zeros(18),
        np.full(4, 0.25 * robot.mass * GRAVITY),
    )  # fmt: skip
    flat = HeightMap(np.zeros((_CELLS, _CELLS), np.float32), _CELL_M, np.zeros(2))
    for elevation in (None, flat):
        tracker = Tracker(robot, plan_from_gait(timing, footholds, start_s=_TICK_S), elevation=elevation)
        for tick in range(_TICKS):
            tracker.step(state, tick * _TICK_S)
