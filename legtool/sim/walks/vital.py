"""ViTAL in closed loop: an operator's velocity, footholds by the criteria (VFA), poses by VPA or the baseline TBR."""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

from legtool.sim.walks.environment import GuidedGait, Observation
from legtool.sim.walks.mapping import Mapper
from legtool.sim.walks.operators import Operator
from legtool.sim.walks.scene import Known
from legtool_runtime import terrain
from legtool_runtime.errors import MapError, StateError
from legtool_runtime.foothold import Criteria, Gait
from legtool_runtime.foothold.pose import Counter, Pose, PosePlanner, terrain_pose
from legtool_runtime.foothold.pose_settings import PoseSettings
from legtool_runtime.foothold.selection import FootholdSelector
from legtool_runtime.rotations import rotation_of, yaw_of
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.terrain.settings import ElevationSettings
from legtool_runtime.tracking.gait_tracker import Guidance
from legtool_runtime.tracking.gaits import GaitTiming
from legtool_runtime.tracking.selectors import Place, Selector, Wish, any_place, safe_places

Array = NDArray[np.float64]

#: The pose is planned anew after so much way, or so much time.
_REPLAN_M, _REPLAN_S = 0.03, 0.1
#: A foot stands that bears this share of what all bear.
_LOADED = 0.08


class VitalPlanner:
    """Footholds and body poses along a route.

    Attributes:
        pose: (3,) planned height of the trunk's origin, world frame [m], roll, pitch [rad]; None before the first.
        planning_times_s: of every plan of a pose.
    """

    def __init__(
        self,
        operator: Operator,
        timing: GaitTiming,
        selector: FootholdSelector,
        *,
        pose: PoseSettings | None,
        network: Counter | None = None,
        coarse: bool = False,
        elevation: ElevationSettings,
    ) -> None:
        """Begin a walk.

        Args:
            operator: whose commands are walked.
            timing: of the gait.
            selector: of footholds (VFA).
            pose: settings of the pose planner (VPA); None: the baseline TBR, the plane through the footholds.
            network: of the pose planner; None: it counts by the criteria.
            coarse: whether it counts by their coarse check, see :class:`.PosePlanner`.
            elevation: of the map that images are fused into.
        """
        criteria: Criteria = selector.criteria
        self.pose: Array | None = None
        self.planning_times_s: list[float] = []
        self._operator, self._timing, self._selector = operator, timing, selector
        self._robot = criteria.robot
        self._poses = None if pose is None else PosePlanner(criteria, pose, network, coarse)
        self._limits = pose or PoseSettings()
        self._mapper = Mapper(criteria.robot, elevation, for_feet=True)
        self._map: HeightMap | None = None
        self._select: Selector = any_place(None)
        self._previous: Pose | None = None
        self._planned_at: tuple[float, Array] | None = None
        self._feet: Array | None = None
        self._command = (0.0, 0.0, 0.0)

    def warm_up(self) -> None:
        """Compile, or load, what plans call, so that the first of them takes no longer than the others."""
        terrain.warm_up()
        self._selector.warm_up()
        if self._poses is not None:
            self._poses.warm_up()

    def asked(self) -> tuple[tuple[float, ...], Gait]:
        """The base twist (6,) that is commanded, and the gait that walks it."""
        vx, vy, rate = self._command
        cycle = self._timing.cycle_s
        step = min(math.hypot(vx, vy) * cycle, 2.0)
        return (vx, vy, 0.0, 0.0, 0.0, rate), Gait(step, 1.0 / cycle, self._timing.stance_s / cycle)

    @property
    def known(self) -> Known:
        """Its map."""
        return Known(terrain=self._map)

    def act(self, observation: Observation) -> GuidedGait:
        """Guidance for the gait; a new map and a new pose when it is time."""
        state = observation.state
        position, yaw = state.position_world, float(yaw_of(rotation_of(state.orientation)))
        if (seen := self._mapper.see(observation)) is not None:
            self._map = seen
            self._select = self._noting(safe_places(self._selector, self._map))
        self._command = self._operator.command(position, yaw)
        if self._map is not None and self._due(observation.time_s, position):
            began = time.perf_counter()
            self._plan(observation, self._map, yaw)
            self.planning_times_s.append(time.perf_counter() - began)
        return GuidedGait(Guidance(self._command, self._select, self.pose, self._map))

    def _due(self, time_s: float, position: Array) -> bool:
        if self._planned_at is None:
            return True
        then, there = self._planned_at
        return time_s - then >= _REPLAN_S - 1e-9 or float(np.hypot(*(position - there)[:2])) >= _REPLAN_M

    def _noting(self, select: Selector) -> Selector:
        """The selector, with notes of where feet go: the baseline's plane lies through these."""

        def noted(wish: Wish) -> Place | None:
            place = select(wish)
            if place is not None and self._feet is not None:
                self._feet[wish.leg] = place.point
            return place

        return noted

    def _plan(self, observation: Observation, elevation: HeightMap, yaw: float) -> None:
        position = observation.state.position_world
        travelled = 0.0 if self._planned_at is None else float(np.hypot(*(position - self._planned_at[1])[:2]))
        self._planned_at = observation.time_s, position.copy()
        if self._feet is None:
            state = observation.state
            self._feet = position + self._robot.feet(state.joint_positions) @ rotation_of(state.orientation).T
            self._feet[:, 2] -= self._robot.foot_radius
        if self._poses is None:
            self.pose = self._baseline(yaw, travelled)
            return
        twist, gait = self.asked()
        try:
            plan = self._poses.plan(
                elevation, base_position=position[:2].tolist(), yaw=yaw,
                base_twist=twist, gait=gait, previous=self._previous, travelled_m=travelled,
                standing=self._standing(observation),
            )  # fmt: skip
        except (MapError, StateError):  # nothing is known below a hip: the pose stays
            return
        self._previous = plan.poses[0]
        self.pose = np.array([self._previous.height, self._previous.roll, self._previous.pitch])

    def _standing(self, observation: Observation) -> Array:
        """(4, 3) centres of the feet that bear load, world frame [m]; NaN for the others."""
        state = observation.state
        feet = state.position_world + self._robot.feet(state.joint_positions) @ rotation_of(state.orientation).T
        loaded = state.foot_forces > _LOADED * state.foot_forces.sum()
        return np.where(loaded[:, None], feet, np.nan)

    def _baseline(self, yaw: float, travelled: float) -> Array:
        """The pose of TBR, the limits on its change those of VPA."""
        assert self._feet is not None
        wanted = terrain_pose(self._feet, yaw=yaw, height=self._robot.standing_height)
        return self._limits.limited(wanted, before=self.pose, travelled_m=max(travelled, _REPLAN_M))
