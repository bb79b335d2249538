"""The torso search (QuadPiPS, section VI-B): a path over ground, a waypoint on it, and the cost to go to there."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.checks import finite
from legtool_runtime.errors import PlannerError
from legtool_runtime.robot import Robot
from legtool_runtime.search.body import body_of
from legtool_runtime.search.candidates import Candidates
from legtool_runtime.search.field_kernels import Field, FieldTask, field_memory, fill_field
from legtool_runtime.search.settings import PipsSettings
from legtool_runtime.search.supports import Supports, supports_of
from legtool_runtime.search.surface import Surface
from legtool_runtime.search.torso_kernels import TorsoTask, pose_of, search_torso, torso_memory

Doubles = NDArray[np.float64]

#: The field reaches so much farther than the torso search [m].
_FIELD_BEYOND = 0.35
#: A foothold never carries a torso whose ideal foot is farther away [m].
_WIDEST_M = 0.5


@dataclass(frozen=True, eq=False)
class TorsoPath:
    """A path of the torso.

    Attributes:
        poses: (m, 4) x, y, z of the base [m], yaw [rad], world frame; the first is the robot's own.
        status: ``reached``: it ends at the goal; ``frontier``: at the best place that ground leads to; ``enclosed``:
            no pose around the robot stands over ground.
        left_m: from its end to the goal, beyond the tolerance.
        expanded: poses.
        planning_time_s: wall time.
    """

    poses: Doubles
    status: Literal["reached", "frontier", "enclosed"]
    left_m: float
    expanded: int
    planning_time_s: float

    @property
    def length_m(self) -> float:
        """Of the path, horizontally."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())

    def waypoint(self, reach: float) -> Doubles:
        """(4,) the last pose within a path length [m]; the second one at least."""
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.poses[:, :2], axis=0).T))])
        return self.poses[max(int(np.searchsorted(way, reach + 1e-9, side="right")) - 1, min(1, len(way) - 1))]


class TorsoPlanner:
    """Searches torso paths for one robot; its memory is allocated once."""

    def __init__(self, robot: Robot, settings: PipsSettings, *, com_offset: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Take the robot, the settings, and the centre of mass (3,) in the base frame [m]."""
        self.robot, self.settings = robot, settings
        self.body = body_of(robot, height_m=settings.height_m, com_offset=com_offset)
        torso = settings.torso
        self._memory = torso_memory(torso.reach, torso.cell)
        self._cells = 2 * math.ceil((torso.reach + _FIELD_BEYOND) / torso.field_cell) + 1
        self._field_memory = field_memory(self._cells)
        self._values = np.zeros((self._cells, self._cells, 16), np.float32)

    def supports(
        self, candidates: Candidates, surface: Surface, position: ArrayLike, *, wider: float = 1.0
    ) -> Supports:
        """What carries torso poses around a place (3,); a candidate counts so many times as far from an ideal foot."""
        t, width = self.settings.torso, self.settings.walkability.width
        return supports_of(
            candidates, self.body, self.robot, replace(t, support=min(wider * t.support, _WIDEST_M)), width=width,
            trunk=surface.trunk, middle=np.asarray(position, dtype=np.float64)[:2],
        )  # fmt: skip

    def plan(
        self,
        supports: Supports,
        *,
        position: ArrayLike,
        yaw: float,
        goal: ArrayLike,
        goal_yaw: float | None = None,
        tabu: Doubles | None = None,
        kept: ArrayLike | None = None,
    ) -> TorsoPath:
        """A path towards a goal.

        Args:
            supports: around the robot.
            position: (3,) of the base, world frame [m].
            yaw: of the base [rad].
            goal: (2,) world frame [m].
            goal_yaw: wanted there [rad]; None: any.
            tabu: (k, 4) x, y, yaw and penalty [m] of waypoints that led nowhere.
            kept: (4,) end of the path that is walked, as a pose; None: none is.

        Raises:
            PlannerError: values that are not finite.
        """
        began = time.perf_counter_ns()
        pose = finite("torso search: pose", [*np.ravel(position), yaw], (4,), PlannerError)
        aim = finite("torso search: goal", goal, (2,), PlannerError)
        t = self.settings.torso
        task = TorsoTask(
            pose, aim, math.nan if goal_yaw is None else float(goal_yaw), 0.75 * t.cell, t.cell, t.reach, t.turn_m,
            t.unseen_m, t.sideways, t.greed, np.empty((0, 4)) if tabu is None else np.ascontiguousarray(tabu),
            np.zeros(4) if kept is None else np.array([*np.asarray(kept)[[0, 1, 3]], t.kept_m]),
        )  # fmt: skip
        count, expanded, left = search_torso(task, supports, self._memory)
        poses = np.empty((count, 4))
        for k in range(count):
            pose_of(task, self._memory, int(self._memory.path[k]), poses[k])
        poses[0] = pose
        status: Literal["reached", "frontier", "enclosed"] = "reached" if left <= 0.0 else "frontier"
        if expanded == 1 and left > 0.0:
            status = "enclosed"
        return TorsoPath(poses, status, left, expanded, (time.perf_counter_ns() - began) * 1e-9)

    def field(
        self,
        supports: Supports,
        *,
        position: ArrayLike,
        yaw: float,
        waypoint: ArrayLike,
        yaw_matters: bool = False,
        tolerance: float | None = None,
        yaw_tolerance: float | None = None,
    ) -> Field:
        """The cost to go to a waypoint (4,) for poses around the robot; overwritten by the next call.

        Args:
            supports: around the robot.
            position: (3,) or (2,) of the base, world frame [m].
            yaw: of the base [rad].
            waypoint: (4,) x, y, z, yaw.
            yaw_matters: whether the waypoint's heading is wanted too.
            tolerance: of the waypoint [m]; None: that of the settings.
            yaw_tolerance: of its heading [rad]; None: that of the settings.
        """
        t, f = self.settings.torso, self.settings.feet
        start = np.array([*np.ravel(position)[:2], yaw], dtype=np.float64)
        goal = np.asarray(waypoint, dtype=np.float64)
        low = np.floor(start[:2] / t.field_cell).astype(np.int64) - self._cells // 2
        field = Field(self._values, low, t.field_cell)
        near = f.tolerance if tolerance is None else tolerance
        within = f.yaw_tolerance if yaw_tolerance is None else yaw_tolerance
        task = FieldTask(
            goal[:2].copy(), near, float(goal[3]) if yaw_matters else math.nan, within, start, t.field_turn_m,
        )  # fmt: skip
        fill_field(task, supports, field, self._field_memory)
        return field
