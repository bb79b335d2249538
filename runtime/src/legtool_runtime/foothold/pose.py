"""Body pose adaptation, VPA (ViTAL, section IV): the pose from which the legs reach the most safe footholds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.errors import StateError
from legtool_runtime.foothold import heightmap
from legtool_runtime.foothold.basis import RadialBasis
from legtool_runtime.foothold.criteria.criteria import Criteria
from legtool_runtime.foothold.gait import Gait
from legtool_runtime.foothold.heightmap import extract_heightmap, median_height
from legtool_runtime.foothold.pose_kernels import LEAST, PRODUCT, SUM, Problem, least_around
from legtool_runtime.foothold.pose_plan import Pose, PosePlan
from legtool_runtime.foothold.pose_search import maximise
from legtool_runtime.foothold.pose_settings import PoseSettings
from legtool_runtime.foothold.pose_stands import FREE, stands_of
from legtool_runtime.foothold.settings import SIZE, hip_heights, leg_length
from legtool_runtime.foothold.tuples import Tuple
from legtool_runtime.legs import Legs
from legtool_runtime.robot import Robot
from legtool_runtime.rotations import place
from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]
T = TypeVar("T")
R = TypeVar("R")
#: Steps of the tables over the hip height.
_TABLE = 161
#: A robot that stands may still change its pose as if it had moved this far [m].
_LEAST_TRAVEL_M = 0.02


class Counter(Protocol):
    """A network that predicts the weights of the safe-foothold function, for the legs of its robot."""

    robot: Robot

    def weights(self, tuples: Sequence[Tuple]) -> Array:
        """(n, E) weights w for maps below hips, heights above the terrain's reference [m]."""


@dataclass
class PosePlanner:
    """Plans the body pose of one robot; a network for another robot is a RobotError.

    Attributes:
        criteria: the exact criteria.
        settings: of the optimisation.
        network: predicts the weights in place of the exact criteria.
        coarse: without a network, count by the coarse check (:meth:`.Criteria.coarse_counts`): poses are planned in a
            quarter of the time, and leave as many safe footholds.
        threads: that count safe footholds: with a network, one for each horizon is of use.
    """

    criteria: Criteria
    settings: PoseSettings = field(default_factory=PoseSettings)
    network: Counter | None = None
    coarse: bool = False
    threads: int = 1

    def __post_init__(self) -> None:
        if self.network is not None:
            self.criteria.refuse_other(self.network.robot, self.network)
        self.hip_heights = hip_heights(self.robot)
        self.legs = Legs.of(self.robot)
        self.basis = RadialBasis(float(self.hip_heights[0]), float(self.hip_heights[-1]))
        grid = np.linspace(self.hip_heights[0], self.hip_heights[-1], _TABLE)
        offsets = self.settings.offsets
        share = 1.0 / (len(offsets) * SIZE * SIZE)
        self._grid = grid
        self._values = share * np.sum([self.basis.functions(grid + o) for o in offsets], axis=0)
        self._slopes = share * np.sum([self.basis.slopes(grid + o) for o in offsets], axis=0)
        self._pool = ThreadPoolExecutor(self.threads - 1) if self.threads > 1 else None

    @property
    def robot(self) -> Robot:
        """The robot that poses are planned for."""
        return self.criteria.robot

    def plan(
        self,
        elevation: HeightMap,
        *,
        base_position: Sequence[float],
        yaw: float,
        base_twist: Sequence[float],
        gait: Gait,
        previous: Pose | None = None,
        travelled_m: float = 0.0,
        attitude: tuple[float, float] | None = None,
        standing: ArrayLike | None = None,
    ) -> PosePlan:
        """Plan the pose (equations 14 to 25).

        Legs are judged below the trunk as it is now, and their safe footholds counted over the hip heights: the pose
        that follows is near, for its change is limited.

        Args:
            elevation: the map.
            base_position: (2,) or (3,) x, y of the trunk, world frame [m].
            yaw: of the trunk [rad].
            base_twist: (6,) v_b, horizontal frame [m/s, rad/s].
            gait: α.
            previous: the pose taken now; None: no limit on the change to the first pose.
            travelled_m: since that pose was planned.
            attitude: (2,) roll and pitch that the legs are judged at [rad]; None: those of ``previous``, else level.
            standing: (4, 3) foot centres of the legs that stand, world frame [m], NaN in the rows of the others; the
                first pose leaves these legs within their bounds, now and a little later
                (:class:`.pose_settings.PoseSettings`), or as near to them as it can. None: no leg binds.

        Raises:
            MapError: a hip lies outside of the map, or the map has another resolution.
            StateError: the rest cannot be used, or nothing is known of the terrain.
        """
        if attitude is None:
            attitude = (0.0, 0.0) if previous is None else (previous.roll, previous.pitch)
        maps, references = self.heightmaps(
            elevation, base_position=base_position, yaw=yaw, base_twist=base_twist, attitude=attitude
        )
        stands = None
        if standing is not None:
            stands = stands_of(
                self.legs, standing, base_position=base_position, yaw=yaw, base_twist=base_twist,
                reference=float(references[0]), stretch=self.settings.stretch, ahead_s=self.settings.ahead_s,
            )  # fmt: skip
        tuples = below_hips(maps, base_twist=base_twist, gait=gait, attitude=attitude)
        if self.network is None:
            weights = self.basis.fit(self.hip_heights, self.counts(tuples))
        else:
            weights = np.array(self._each(self.network.weights, tuples))
        return self.optimise(weights, references, previous=previous, travelled_m=travelled_m, stands=stands)

    def heightmaps(
        self,
        elevation: HeightMap,
        *,
        base_position: Sequence[float],
        yaw: float,
        base_twist: Sequence[float],
        attitude: tuple[float, float] = (0.0, 0.0),
    ) -> tuple[NDArray[np.float32], Array]:
        """Cut the maps below the hips of every horizon (appendix E), of a trunk with ``attitude`` (2,) roll, pitch.

        Returns:
            (h, 4, 33, 33) heights above each horizon's reference [m], and (h,) those references, world frame [m]: the
            median of what is known of the horizon's four maps. A horizon of which nothing is known, or whose reference
            is farther from that of the horizon before than the height may change in between, is taken to be like it.

        Raises:
            MapError: a hip of the first horizon lies outside of the map.
            StateError: nothing is known below one horizon.
        """
        c, s = math.cos(yaw), math.sin(yaw)
        speed = math.hypot(base_twist[0], base_twist[1])
        direction = (base_twist[0] / speed, base_twist[1] / speed) if speed > 1e-3 else (1.0, 0.0)
        hips, horizons = place(self.robot.hips, *attitude, 0.0), self.settings.horizons
        maps = np.empty((horizons, 4, SIZE, SIZE), np.float32)
        references = np.empty(horizons)
        for j in range(horizons):
            for leg in range(4):
                x = hips[leg, 0] + j * self.settings.shift_m * direction[0]
                y = hips[leg, 1] + j * self.settings.shift_m * direction[1]
                center = (base_position[0] + c * x - s * y, base_position[1] + s * x + c * y)
                maps[j, leg] = extract_heightmap(elevation, center, yaw=yaw, outside=j > 0)
            references[j] = median_height(maps[j])
            if j == 0 and math.isnan(references[j]):
                raise StateError("pose: nothing is known of the terrain below the hips; map it first")
            most = self.settings.height_per_m * self.settings.shift_m
            if j > 0 and not abs(references[j] - references[j - 1]) <= most:
                # Beyond the map, or a level to which the trunk cannot follow: keep up the pose of the horizon before.
                maps[j], references[j] = maps[j - 1], references[j - 1]
                continue
            maps[j] -= references[j]
        return maps, references

    def counts(self, tuples: Sequence[Sequence[Tuple]]) -> Array:
        """Numbers of safe footholds (h, 4, 31) over the set of hip heights, of each horizon's four tuples."""
        every = [t for four in tuples for t in four]
        if self.coarse:
            counted = self._each(lambda t: self.criteria.coarse_counts(t, self.hip_heights)[0], every)
        else:
            counted = self._each(lambda t: self.criteria.counts(t, self.hip_heights), every)
        return np.array(counted, dtype=np.float64).reshape(len(tuples), 4, -1)

    def _each(self, function: Callable[[T], R], items: Sequence[T]) -> list[R]:
        """``function`` of each item, on all threads; this one takes its share, so that it need not be woken."""
        if self._pool is None:
            return [function(item) for item in items]
        begun = [self._pool.submit(function, item) for item in items]
        # From the end on what no other thread has begun.
        out = [
            function(x) if task.cancel() else task.result() for task, x in zip(begun[::-1], items[::-1], strict=True)
        ]
        return out[::-1]

    def optimise(
        self,
        weights: ArrayLike,
        references: ArrayLike,
        *,
        previous: Pose | None = None,
        travelled_m: float = 0.0,
        stands: Array | None = None,
    ) -> PosePlan:
        """Find the poses for given safe-foothold functions.

        Args:
            weights: (h, 4, E).
            references: (h,) heights of the terrain [m].
            previous: the pose taken now.
            travelled_m: since that pose was planned.
            stands: (m, 8) bounds of standing legs, see :func:`.pose_stands.stands_of`.
        """
        w = np.asarray(weights, dtype=np.float64)
        problem, guess = self.problem(w, references, previous=previous, travelled_m=travelled_m, stands=stands)
        u = guess.copy()
        value = maximise(problem, guess, u)
        if not np.isfinite(value):
            # A terrain reference that jumps can leave no pose within all limits: the first horizon alone decides.
            single = problem._replace(
                values=problem.values[:1], slopes=problem.slopes[:1], low=problem.low[:1], high=problem.high[:1],
                references=problem.references[:1],
            )  # fmt: skip
            first = guess[:1].copy()
            value = maximise(single, guess[:1], first)
            u[:] = first[0]
        refs = np.asarray(references, dtype=np.float64)
        poses = tuple(
            Pose(float(u[j, 0] + refs[j]), float(u[j, 1]), float(u[j, 2]), self.promised(w[j], u[j]), float(refs[j]))
            for j in range(len(u))
        )
        return PosePlan(poses, w, float(value))

    def promised(self, weights: Array, pose: ArrayLike) -> Array:
        """(4,) F̂ of each leg for weights (4, E) at a pose (3,): height above the reference, roll, pitch."""
        z = hips_above(self.robot.hips, pose)
        return np.einsum("le,le->l", self.basis.functions(z), weights)

    def problem(
        self,
        weights: Array,
        references: ArrayLike,
        *,
        previous: Pose | None = None,
        travelled_m: float = 0.0,
        stands: Array | None = None,
    ) -> tuple[Problem, Array]:
        """The optimisation problem in the solver's form, and a pose (h, 3) to start from."""
        s = self.settings
        h = len(weights)
        refs = np.array(references, dtype=np.float64)
        span = leg_length(self.robot) / 0.68
        # Bounds of appendix F, z_b for a base whose hips may lie beside its origin.
        offset = -float(self.robot.hips[:, 2].mean())
        low = np.tile([0.2 * span + offset, -s.angle, -s.angle], (h, 1))
        high = np.tile([0.8 * span + offset, s.angle, s.angle], (h, 1))
        per_m = s.per_m
        guess = np.tile([self.robot.standing_height, 0.0, 0.0], (h, 1))
        if previous is not None:
            now = np.array([previous.height - refs[0], previous.roll, previous.pitch])
            reach = per_m * max(travelled_m, _LEAST_TRAVEL_M)
            # Where terrain rises faster than the pose may follow, the limit on the change goes before the bounds.
            now = np.clip(now, low[0] - reach, high[0] + reach)
            low[0], high[0] = np.maximum(low[0], now - reach), np.minimum(high[0], now + reach)
            guess[:] = now
        guess = np.clip(guess, low, high)
        kind = {"product": PRODUCT, "robust": LEAST}.get(s.cost, SUM)
        values, slopes, step = weights @ self._values.T, weights @ self._slopes.T, float(self._grid[1] - self._grid[0])
        if s.cost == "robust":
            means, values = values, np.empty_like(values)
            least_around(means, round(s.margin_m / step), step, values, slopes)
        problem = Problem(
            np.ascontiguousarray(self.robot.hips).copy(),
            np.ascontiguousarray(values, dtype=np.float64),
            np.ascontiguousarray(slopes, dtype=np.float64),
            float(self._grid[0]), step,
            low, high, refs, per_m * s.shift_m, float(s.smoothness), kind,
            FREE if stands is None else stands,
        )  # fmt: skip
        return problem, guess

    def warm_up(self) -> None:
        """Compile all kernels, or load them from the user's cache."""
        heightmap.warm_up()
        self.criteria.warm_up()
        weights = np.ones((self.settings.horizons, 4, self.basis.count))
        self.optimise(weights, np.zeros(self.settings.horizons))


def below_hips(
    maps: NDArray[np.float32],
    *,
    base_twist: Sequence[float],
    gait: Gait,
    attitude: tuple[float, float] = (0.0, 0.0),
) -> list[list[Tuple]]:
    """The four tuples of each horizon, for maps (h, 4, 33, 33) as :meth:`PosePlanner.heightmaps` gives them.

    Raises:
        StateError: a base twist or attitude (2,), roll and pitch [rad], that cannot be.
    """
    roll, pitch = attitude
    return [
        [Tuple(h, leg=leg, base_twist=base_twist, gait=gait, roll=roll, pitch=pitch) for leg, h in enumerate(four)]
        for four in maps
    ]


def hips_above(hips: ArrayLike, pose: ArrayLike) -> Array:
    """(4,) hip heights of a pose (3,): height, roll β, pitch γ (equation 33) [m]."""
    height, roll, pitch = np.asarray(pose, dtype=np.float64)
    return place(hips, roll, pitch, 0.0, (0.0, 0.0, height))[:, 2]


def terrain_pose(footholds: ArrayLike, *, yaw: float, height: float) -> tuple[float, float, float]:
    """The baseline TBR (section VI-D): the plane through the chosen footholds.

    Args:
        footholds: (4, 3) world frame [m].
        yaw: of the trunk [rad].
        height: of the trunk's origin above the plane's centre [m].

    Returns:
        height of the trunk's origin, world frame [m], roll and pitch [rad].
    """
    p = np.asarray(footholds, dtype=np.float64)
    center = p.mean(axis=0)
    c, s = math.cos(yaw), math.sin(yaw)
    d = p - center
    forward, left = c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1]
    (a, b), *_ = np.linalg.lstsq(np.column_stack([forward, left]), d[:, 2], rcond=None)
    pitch = -math.atan(a)
    # The trunk's y axis lies in the plane too: tan roll = b cos pitch.
    return float(center[2] + height), math.atan(b * math.cos(pitch)), pitch
