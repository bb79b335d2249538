"""The planner of QuadPiPS as a chain: regions, candidates, torso path, footholds, contact plan; one call a frame."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.checks import finite
from legtool_runtime.errors import LegtoolError, PlannerError
from legtool_runtime.perception.regions import Regions
from legtool_runtime.robot import LEGS, Robot
from legtool_runtime.search.body import trunk_width
from legtool_runtime.search.candidates import Candidates, find_candidates
from legtool_runtime.search.contact_plans import (
    Committed,
    committed,
    contact_plan,
    last_places,
    remaining,
    timing_of,
)
from legtool_runtime.search.feet import FootPlan, FootPlanner, FootProblem
from legtool_runtime.search.settings import PipsSettings
from legtool_runtime.search.surface import Surface
from legtool_runtime.search.torso import LEAST_WAY_M, TorsoPath, TorsoPlanner
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance
from legtool_runtime.tracking.ground import height_at

Doubles = NDArray[np.float64]
Status = Literal["walking", "reached", "exhausted"]

#: A foot that stands so far above the known ground is in the air [m].
_AIR_M = 0.06
#: Penalty of a waypoint that no footholds lead to, when it is found [m]; smaller ones are forgotten.
_TABU_M, _FORGOTTEN_M = 2.0, 0.05
#: Least share of the path that a waypoint is backed off to before it is tabu.
_LEAST_SHARE = 0.25
#: After so many waypoints that led nowhere the robot stands, unless ground is seen that leads so much nearer [m].
_FAILURES, _NEARER_M = 5, 0.2
#: What a search that the deadline ended counts among them.
_LATE = 0.25
#: The tolerance of a waypoint is at most such a share of the way to it, and at the goal of the goal's own.
_NEAR = 0.7
#: A foothold that is planned is still there if a candidate lies so near, horizontally and in height [m].
_SAME_M = 0.03


@dataclass(frozen=True, eq=False)
class PipsPlan:
    """The answer of a frame.

    Attributes:
        status: ``walking``: the plan leads on; ``reached``: the robot is at the goal; ``exhausted``: nothing new leads
            on, and the plan is what is left of the last one.
        reason: why it is exhausted, or why the path is only partial.
        plan: to be followed, on the tracker's clock.
        changed: whether it differs from the plan that was given.
        candidates: of this frame.
        torso: path of the torso; None where it was not searched.
        feet: path of stances; None where it was not searched.
        waypoint: (4,) x, y, z [m], yaw [rad] that the footholds lead to; None as the torso's path.
        times_s: wall time of each stage: candidates, torso, field, feet, plan, whole.
    """

    status: Status
    reason: str
    plan: ContactPlan
    changed: bool
    candidates: Candidates | None = None
    torso: TorsoPath | None = None
    feet: FootPlan | None = None
    waypoint: Doubles | None = None
    times_s: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class _Frame:
    """What is known in a frame: base position (3,) and yaw, feet (4, 3) with normals, goal (2,), its yaw, clock."""

    position: Doubles
    yaw: float
    feet: Doubles
    normals: Doubles
    goal: Doubles
    goal_yaw: float | None
    time_s: float


class Pips:
    """Plans footholds over planar regions, frame after frame, for a robot that is walking.

    What the tracker has begun is kept: the search goes on from the stance that the feet will stand in then. Values that
    cannot be used raise before the robot walks; in mid-walk they are answered ``exhausted`` in the same words.

    Attributes:
        robot: that walks.
        settings: of all stages.
    """

    def __init__(
        self, robot: Robot, settings: PipsSettings | None = None, *, com_offset: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        """Take the robot, the settings (None: :meth:`.PipsSettings.of` the robot), and the centre of mass (3,) in the
        base frame [m].

        Raises:
            PlannerError: a height that the legs do not reach.
            TrackingError: a centre of mass that is not three finite numbers.
        """
        self.robot, self.settings = robot, settings or PipsSettings.of(robot)
        self._torso = TorsoPlanner(robot, self.settings, com_offset=com_offset)
        self._feet = FootPlanner(robot, self.settings, com_offset=com_offset)
        self.reset()

    def reset(self) -> None:
        """Forget the past: goals given up, waypoints that led nowhere, refused transitions."""
        self._tabu: list[tuple[float, float, float, float]] = []
        self._refused: list[tuple[float, int]] = []
        self._share = 1.0
        self._gait: str | None = None
        self._now_s = 0.0
        self._goal = np.full(2, np.nan)
        self._failures, self._least_m = 0.0, math.inf

    def warm_up(self) -> None:
        """Compile, or load, what a frame calls."""
        self._feet.warm_up()
        half = 1.5
        corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
        one = np.zeros(1)
        floor = Regions(np.eye(4)[None], (corners,), one + 9.0, one, one, one > 0, np.zeros(1, int), np.zeros(1, int))
        feet = self.robot.stance * [1.0, 1.0, 0.0]
        height, plan = self.robot.standing_height, None
        ground = HeightMap(np.zeros((40, 40), np.float32), 0.05, np.zeros(2))
        for frame in range(2):
            plan = self.plan(
                floor, position=[0, 0, height], yaw=0.0, feet=feet, goal=[3, 0], time_s=0.1 * frame, plan=plan,
                elevation=ground,
            ).plan  # fmt: skip
        self.reset()

    def refuse(self, before: ArrayLike, after: ArrayLike, time_s: float) -> None:
        """Do not plan a transition again for some seconds: tracking could not walk it.

        Args:
            before: (4, 3) contact points, world frame [m].
            after: (4, 3) where it led.
            time_s: now.
        """
        spacing = self.settings.candidates.spacing
        self._refused.append((time_s + self.settings.refused_s, self._feet.signature(before, after, spacing)))

    def avoid(self, waypoint: ArrayLike, time_s: float) -> None:
        """Take another way for some time: a waypoint (4,) x, y, z [m], yaw [rad] stopped the robot again and again."""
        x, y, _, yaw = finite("pips: waypoint", waypoint, (4,), PlannerError).tolist()
        self._tabu.append((x, y, yaw, time_s))

    def plan(
        self,
        regions: Regions,
        *,
        position: ArrayLike,
        yaw: float,
        feet: ArrayLike,
        goal: ArrayLike,
        time_s: float,
        plan: ContactPlan | None = None,
        goal_yaw: float | None = None,
        elevation: HeightMap | None = None,
    ) -> PipsPlan:
        """One frame.

        Args:
            regions: that feet may be set on, world frame.
            position: (3,) of the base, world frame [m].
            yaw: of the base [rad].
            feet: (4, 3) contact points of the feet, world frame [m]; they count where there is no plan.
            goal: (2,) for the base, world frame [m].
            time_s: now, on the clock of ``plan``.
            plan: that the tracker walks now, as it has changed it (``Tracker.plan``); None: the robot stands.
            goal_yaw: wanted at the goal [rad]; None: any.
            elevation: heights of what is not steppable too; None: only the regions are known.

        Raises:
            PlannerError: regions or values that cannot be used, where the robot stands (``plan`` is None).
        """
        began = time.perf_counter_ns()
        times: dict[str, float] = {}
        standing = plan if plan is not None else None
        try:
            frame = self._frame(position, yaw, feet, goal, goal_yaw, time_s)
            if standing is None:
                standing = ContactPlan(
                    [[Stance(-math.inf, math.inf, frame.feet[leg], frame.normals[leg])] for leg in range(4)]
                )
            answer = self._plan(regions, frame, standing, elevation, times)
        except LegtoolError as problem:
            if standing is None or plan is None:
                raise
            answer = PipsPlan("exhausted", str(problem), plan, False)
        times["whole"] = (time.perf_counter_ns() - began) * 1e-9
        answer.times_s.update(times)
        return answer

    def _frame(
        self, position: ArrayLike, yaw: float, feet: ArrayLike, goal: ArrayLike, goal_yaw: float | None, time_s: float
    ) -> _Frame:
        values = finite("pips: yaw, time, yaw at the goal", [yaw, time_s, goal_yaw or 0.0], (3,), PlannerError)
        return _Frame(
            finite("pips: position", position, (3,), PlannerError), float(values[0]),
            finite("pips: feet", feet, (4, 3), PlannerError), np.tile([0.0, 0.0, 1.0], (4, 1)),
            finite("pips: goal", goal, (2,), PlannerError), goal_yaw, float(values[1]),
        )  # fmt: skip

    def _plan(
        self, regions: Regions, frame: _Frame, now: ContactPlan, elevation: HeightMap | None, times: dict[str, float]
    ) -> PipsPlan:
        s, self._now_s = self.settings, frame.time_s
        timing = timing_of(self._gait or s.feet.gaits[0])
        kept = committed(now, frame.time_s + s.commit_s, timing.full_stance_s)
        feet, normals = last_places(kept.plan)
        start, heading = self._start(frame, feet)
        if np.hypot(*(frame.position[:2] - frame.goal)) <= s.goal_tolerance and self._faces(frame):
            return PipsPlan("reached", "", kept.plan, _differs(kept.plan, now))
        with _Clock(times, "candidates"):
            found, surface = find_candidates(
                regions, position=start, settings=s.candidates, trunk_width=trunk_width(self.robot), elevation=elevation
            )
        if why := self._in_air(frame, now, surface):
            return PipsPlan("exhausted", why, kept.plan, _differs(kept.plan, now), found)
        with _Clock(times, "torso"):
            carried = found.with_feet(feet, normals, s.candidates.spacing)
            supports = self._torso.supports(carried, surface, start)
            path = self._torso.plan(
                supports, position=start, yaw=heading, goal=frame.goal, goal_yaw=frame.goal_yaw,
                tabu=self._tabus(),
            )  # fmt: skip
        if why := self._given_up(frame.goal, path):
            return self._stay(kept, now, frame, found, why, path)
        waypoint = path.waypoint(max(self._share * min(path.length_m, s.torso.reach), LEAST_WAY_M)).copy()
        ends_there = path.status == "reached" and np.allclose(waypoint, path.poses[-1])
        if ends_there:
            waypoint[:2] = frame.goal
        if path.status == "enclosed" or len(path.poses) < 2:
            why = f"torso search: {path.left_m:.2f} m from the goal no pose that is nearer stands over ground"
            return self._stay(kept, now, frame, found, why, path)
        far = float(np.hypot(*(waypoint[:2] - start[:2])))
        tolerance = min(s.feet.tolerance, _NEAR * (s.goal_tolerance if ends_there else far))
        field = None
        if s.cost_to_go:
            with _Clock(times, "field"):
                field = self._torso.field(
                    supports, position=start, yaw=heading, waypoint=waypoint,
                    yaw_matters=ends_there and frame.goal_yaw is not None, tolerance=tolerance,
                )  # fmt: skip
        near = found.near(path.poses, s.candidates.most)
        problem = FootProblem(
            near, surface, feet, normals, waypoint[:3],
            frame.goal_yaw if ends_there else None, kept.swung, field,
            np.array([r.place for r in remaining(now, frame.time_s)]).reshape(-1, 3),
            self._refusals(frame.time_s), tolerance,
        )  # fmt: skip
        with _Clock(times, "feet"):
            steps = self._feet.plan(problem)
        if steps.status == "found" and len(steps) == 0 and ends_there:
            return PipsPlan("walking", "", kept.plan, _differs(kept.plan, now), near, path, steps, waypoint)
        if steps.status not in ("found", "partial") or len(steps) == 0:
            self._back_off(path, waypoint, _LATE if steps.out_of_time else 1.0)
            why = f"foothold search: {steps.reason or 'the feet stand at the waypoint'}"
            return self._stay(kept, now, frame, near, why, path, steps, waypoint)
        self._share, self._gait = min(2.0 * self._share, 1.0), steps.gait
        with _Clock(times, "plan"):
            new = contact_plan(steps, start_s=kept.ready_s, before=kept.plan)
        return PipsPlan("walking", steps.reason, new, True, near, path, steps, waypoint)

    def _given_up(self, goal: Doubles, path: TorsoPath) -> str:
        """Why the robot stands until it sees more: waypoints without footholds, one after the other; empty if not."""
        if not np.array_equal(goal, self._goal):
            self._goal, self._failures, self._least_m = goal.copy(), 0.0, math.inf
        if path.left_m < self._least_m - _NEARER_M:
            self._failures, self._least_m = 0.0, path.left_m
        if self._failures < _FAILURES:
            return ""
        return f"{_FAILURES} waypoints led nowhere; ground that is seen ends {path.left_m:.2f} m before the goal"

    def _start(self, frame: _Frame, feet: Doubles) -> tuple[Doubles, float]:
        """Base position (3,) and heading over the feet (4, 3) that the search starts from."""
        ahead = feet[0] + feet[1] - feet[2] - feet[3]
        heading = math.atan2(ahead[1], ahead[0]) if math.hypot(ahead[0], ahead[1]) > 0.02 else frame.yaw
        above = self._torso.body.height + self._torso.body.radius
        return feet.mean(axis=0) + np.array([0.0, 0.0, above]), heading

    def _faces(self, frame: _Frame) -> bool:
        """Whether the heading is the one that is wanted at the goal."""
        if frame.goal_yaw is None:
            return True
        return abs(math.remainder(frame.yaw - frame.goal_yaw, 2.0 * math.pi)) <= self.settings.feet.yaw_tolerance

    def _in_air(self, frame: _Frame, now: ContactPlan, surface: Surface) -> str:
        """What is wrong with how a robot stands: a foot in the air, two feet at one place; empty if nothing is."""
        if not now.standing(frame.time_s).all() or now.events():
            return ""
        for leg, name in enumerate(LEGS):
            x, y, z = frame.feet[leg]
            above = float(z) - height_at(surface.ground, float(x), float(y))
            near = np.linalg.norm(frame.feet[:leg] - frame.feet[leg], axis=1)
            if len(near) and near.min() < 2.0 * self.robot.foot_radius:
                return f"start: {LEGS[int(near.argmin())]} and {name} stand at one place"
            if above > _AIR_M:  # never where the ground is unknown
                return f"start: {name} is {100 * above:.0f} cm above the ground; let the robot stand first"
        return ""

    def _stay(
        self, kept: Committed, now: ContactPlan, frame: _Frame, found: Candidates, why: str, path: TorsoPath,
        steps: FootPlan | None = None, waypoint: Doubles | None = None,
    ) -> PipsPlan:  # fmt: skip
        """The answer where nothing new leads on: the last plan while its footholds are there, else what has begun."""
        ahead = [r for r in remaining(now, frame.time_s) if math.isfinite(r.begin_s)]
        there = all(_near(r.place, found.points) for r in ahead)
        plan = now if there else kept.plan
        return PipsPlan("exhausted", why, plan, plan is not now and _differs(plan, now), found, path, steps, waypoint)

    def _back_off(self, path: TorsoPath, waypoint: Doubles, failure: float) -> None:
        """After a failure, which counts so much: a waypoint half as far; where that is too near, none like it for some
        time."""
        self._share *= 0.5
        if self._share < _LEAST_SHARE or self._share * path.length_m < LEAST_WAY_M:
            self._failures += failure
            self._tabu.append((float(waypoint[0]), float(waypoint[1]), float(waypoint[3]), self._now_s))
            self._share = 1.0

    def _tabus(self) -> Doubles:
        """(k, 4) x, y, yaw and penalty of waypoints that led nowhere."""
        out = []
        for x, y, yaw, since in self._tabu:
            penalty = _TABU_M * 0.5 ** ((self._now_s - since) / self.settings.tabu_s)
            if penalty > _FORGOTTEN_M:
                out.append([x, y, yaw, penalty])
        return np.array(out).reshape(-1, 4)

    def _refusals(self, time_s: float) -> list[int]:
        self._refused = [(until, what) for until, what in self._refused if until > time_s]
        return [what for _, what in self._refused]


class _Clock:
    """Writes the wall time of a block into a dictionary [s]."""

    def __init__(self, times: dict[str, float], name: str) -> None:
        self._times, self._name, self._began = times, name, 0

    def __enter__(self) -> None:
        self._began = time.perf_counter_ns()

    def __exit__(self, *_: object) -> None:
        self._times[self._name] = (time.perf_counter_ns() - self._began) * 1e-9


def _near(place: Doubles, points: Doubles) -> bool:
    """Whether one of the points (n, 3) is that place."""
    if not len(points):
        return False
    off = np.abs(points - place)
    return bool(((np.hypot(off[:, 0], off[:, 1]) <= _SAME_M) & (off[:, 2] <= _SAME_M)).any())


def _differs(a: ContactPlan, b: ContactPlan) -> bool:
    """Whether two plans have other stances."""
    return [len(r) for r in a.stances] != [len(r) for r in b.stances] or any(
        s.end_s != t.end_s for r, q in zip(a.stances, b.stances, strict=True) for s, t in zip(r, q, strict=True)
    )
