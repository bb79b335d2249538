"""How well a trunk is where it was planned, and how many safe footholds its true pose leaves, along a walk."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.sim.controllers.tracked import GuidedController
from legtool.sim.walks.environment import Answer, Observation
from legtool.sim.walks.simulated import SimulatedRobot
from legtool.sim.walks.vital import VitalPlanner
from legtool.sim.worlds.heights import elevation_map
from legtool_runtime.errors import LegtoolError
from legtool_runtime.foothold import RESOLUTION_M, Criteria, Tuple
from legtool_runtime.foothold.heightmap import extract_heightmap
from legtool_runtime.rotations import angles_of, place, rotation_of

Array = NDArray[np.float64]

#: Ticks between looks.
_EVERY = CONTROL_RATE_HZ // 10
#: Heights below a robot that differ by more than this are a climb [m].
_UNEVEN_M = 0.01
#: Terrain beside and beyond the way that is mapped [m].
_BESIDE_M = 1.6


class Moment(NamedTuple):
    """``time_s``; ``place`` (3,) of the trunk's origin [m]; ``attitude`` roll, pitch, yaw [rad]; ``planned`` and
    ``filtered`` (3,) height [m], roll, pitch [rad]; ``safe``: safe footholds of the worst leg; ``climbs``: whether the
    ground below the robot is uneven."""

    time_s: float
    place: Array
    attitude: tuple[float, float, float]
    planned: Array
    filtered: Array
    safe: int
    climbs: bool


class Postures:
    """Looks at the trunk ten times a second, on the true state and terrain; a :class:`.Subscriber`.

    Attributes:
        moments: in order.
    """

    def __init__(
        self, environment: SimulatedRobot, controller: GuidedController, planner: VitalPlanner, criteria: Criteria
    ) -> None:
        assert environment.world is not None
        self.moments: list[Moment] = []
        self._environment, self._controller, self._planner = environment, controller, planner
        self._criteria = criteria
        world = environment.world
        ends = np.stack([world.start[:2], world.goal])
        size = np.ptp(ends, axis=0) + 2 * _BESIDE_M
        self._map = elevation_map(world, ends.mean(axis=0), (float(size[0]), float(size[1])), RESOLUTION_M)

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """Look, when it is time."""
        del answer
        environment = self._environment
        tracker = self._controller.tracker
        if (environment.simulation.tick - 1) % _EVERY or tracker is None:
            return
        if self._planner.pose is None or tracker.filtered_pose is None:
            return
        robot, data = environment.simulation.robot, environment.simulation.data
        base = data.qpos[robot.base_qpos : robot.base_qpos + 7]
        attitude = angles_of(rotation_of(base[3:]))
        safe = self._safe(observation, base[:3], attitude)
        now, filtered = observation.time_s, tracker.filtered_pose.copy()
        planned, climbs = self._planner.pose.copy(), self._climbs(base[:3])
        self.moments.append(Moment(now, base[:3].copy(), attitude, planned, filtered, safe, climbs))

    def end(self) -> None:
        """Nothing to close."""

    def _safe(self, observation: Observation, base: Array, attitude: tuple[float, float, float]) -> int:
        """Safe footholds of the worst leg below its hip, at the true pose and the velocity commanded."""
        roll, pitch, yaw = attitude
        twist, gait = self._planner.asked()
        counts = []
        try:
            for leg in range(4):
                hip = place(self._criteria.robot.hips[leg], roll, pitch, yaw, base)
                heights = extract_heightmap(self._map, hip[:2], yaw=yaw, outside=True)
                t = Tuple(heights, leg=leg, base_twist=twist, gait=gait, roll=roll, pitch=pitch)
                counts.append(int(self._criteria.counts(t, [float(hip[2])])[0]))
        except LegtoolError:  # a robot that falls
            return 0
        return min(counts)

    def _climbs(self, base: Array) -> bool:
        reach = np.abs(self._criteria.robot.stance[:, :2]).max(axis=0)
        low, cell = self._map.lower_corner, self._map.resolution_m
        first = np.maximum(np.floor((base[:2] - reach.max() - low) / cell).astype(int), 0)
        last = np.floor((base[:2] + reach.max() - low) / cell).astype(int) + 1
        seen = self._map.heights[first[0] : last[0], first[1] : last[1]]
        return bool(np.isfinite(seen).any() and np.nanmax(seen) - np.nanmin(seen) > _UNEVEN_M)
