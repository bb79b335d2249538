"""Swing trajectory optimisation (QuadPiPS, VI-D): from a contact plan to a motion of the whole robot, or a refusal."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.checks import finite, is_rotation
from legtool_runtime.errors import PlannerError
from legtool_runtime.perception.regions import Regions
from legtool_runtime.robot import LEGS
from legtool_runtime.search.swings.motion import places
from legtool_runtime.search.swings.problem import Limits, SwingProblem, Workspace, make_workspace
from legtool_runtime.search.swings.reference import (
    LEG_M,
    Course,
    Knots,
    leg_length,
    make_course,
    make_knots,
    stand_first,
    swing_demand,
    window_end,
)
from legtool_runtime.search.swings.settings import SwingSettings
from legtool_runtime.search.swings.solver import CONVERGED, SINGULAR, solve
from legtool_runtime.search.swings.verdict import RULES, Judged, Worst, judge
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.body_reference import BodyReference, ReferenceMaker
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.dynamics import GRAVITY, make_terms
from legtool_runtime.tracking.ground import ground_of
from legtool_runtime.tracking.model import TrackedRobot

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: A motion that has no lift-off after its last touchdown goes on for so long, until the body is at rest [s].
_REST_S = 0.3
#: Where a bound of these rules is passed, barriers are made stiffer once: so many times as high and as narrow.
_BOUNDED, _HIGHER, _NARROWER = ("friction", "joint limit", "joint speed", "torque"), 4.0, 0.5
#: A foothold belongs to a region whose plane passes so near [m].
_ON_PLANE_M = 0.03
#: Equalities that are off by more are not met.
_MISSED = 1e-3
#: Height of the centre of mass over the feet that weights are written for [m].
_SIZE_M = 0.55
#: In which order broken rules are looked for.
_FIRST = ("clearance", "torque", "joint limit", "joint speed", "friction", "load", "tilt", "slip", "defect")
#: Units of the rules, and what a value above its bound means.
_UNITS = ("", " m", " of the weight", " of the weight", " rad", " of the limit", " of the limit", " m", " rad")


class SwingState(NamedTuple):
    """Where a motion begins, world frame: ``com`` (3,) centre of mass [m], ``velocity`` (3,) [m/s], ``momentum`` (3,)
    angular, about it, by the robot's mass [m²/s], ``rotation`` (3, 3) base to world. Joints follow from the feet, which
    are where the plan has them."""

    com: Array
    velocity: Array
    momentum: Array
    rotation: Array


@dataclass(frozen=True, eq=False)
class SwingMotion:
    """An optimised motion, or why there is none. Forces and joint rates are constant between knots.

    Attributes:
        accepted: whether all rules hold.
        rule: the one that is broken; empty where none is.
        reason: in words; empty where it is accepted.
        times_s: (n + 1,) of the knots, the plan's clock.
        com, velocity, momentum: (n + 1, 3) as in :class:`SwingState`.
        base: (n + 1, 3) origin of the base [m].
        rotations: (n + 1, 3, 3).
        joints: (n + 1, 12) [rad].
        forces: (n, 4, 3) on the feet, world frame [N].
        rates: (n, 12) of the joints [rad/s].
        feet: (n + 1, 4, 3) centres of the feet [m].
        standing: (n, 4).
        converged: whether the solver came to rest within its passes.
        passes: of the solver.
        cost: of the problem.
        worst: by rule, what the check found [in the rule's unit].
        solve_s: wall time of reference, solver and check.
    """

    accepted: bool
    rule: str
    reason: str
    times_s: Array
    com: Array
    velocity: Array
    momentum: Array
    base: Array
    rotations: Array
    joints: Array
    forces: Array
    rates: Array
    feet: Array
    standing: Flags
    converged: bool
    passes: int
    cost: float
    worst: dict[str, float]
    solve_s: float

    def state(self, time_s: float) -> SwingState:
        """The state at an instant, held at both ends; between knots states are interpolated evenly."""
        times = self.times_s
        k = min(max(int(np.searchsorted(times, time_s, side="right")) - 1, 0), len(times) - 2)
        share = min(max((time_s - times[k]) / (times[k + 1] - times[k]), 0.0), 1.0)
        parts = (self.com, self.velocity, self.momentum, self.rotations)
        com, velocity, momentum, rotation = ((1.0 - share) * p[k] + share * p[k + 1] for p in parts)
        left, _, right = np.linalg.svd(rotation)
        return SwingState(com, velocity, momentum, left @ right)


class _End(NamedTuple):
    """How the solver ended: ``ended`` as it says, ``passes``, ``cost``, ``violation``."""

    ended: int
    passes: int
    cost: float
    violation: float


class SwingOptimiser:
    """Optimises motions of one robot; keeps memory from one to the next.

    Attributes:
        robot: that moves.
        settings: of problem, solver and check.
        joint_speed: limit of the joints, for this robot's size [rad/s].
    """

    def __init__(self, robot: TrackedRobot, settings: SwingSettings | None = None) -> None:
        """Take the robot and the settings."""
        self.robot, self.settings = robot, settings or SwingSettings()
        self._model, self._terms = robot.model(), make_terms()
        self._maker = ReferenceMaker(robot.geometry, com_offset=robot.com)
        self._work: Workspace | None = None
        self.joint_speed = self.settings.joint_speed / (float(leg_length(robot.geometry)) / LEG_M)
        self._limits = self._limits_of()
        self._weights = self._weights_of()

    def _limits_of(self) -> Limits:
        s, joints = self.settings, self.robot.geometry.joint_limits.reshape(12, 2)
        torque = s.inside * self.robot.torque_limit.ravel() / (self.robot.mass * GRAVITY)
        return Limits(
            s.inside * s.friction, s.least, s.most, joints[:, 0].copy(), joints[:, 1].copy(),
            s.inside * self.joint_speed, torque, s.barrier, s.smooth,
        )  # fmt: skip

    def _weights_of(self) -> Array:
        """(3, 24) of states on the way, at the end, and of inputs; lengths by the robot's height, times by its root."""
        s, size = self.settings, self._maker.height / _SIZE_M
        row = np.repeat([s.velocity / size, s.momentum / size**3, s.place / size**2, s.tilt, s.joint], [3, 3, 3, 3, 12])
        row[8] = s.height / size**2
        return np.stack([row, s.final * row, np.repeat([s.force, s.rate * size], 12)])

    def optimise(
        self,
        plan: ContactPlan,
        *,
        start_s: float,
        start: SwingState | None = None,
        body: BodyReference | None = None,
        elevation: HeightMap | None = None,
        regions: Regions | None = None,
        window: int | None = None,
    ) -> SwingMotion:
        """The motion of the plan's next transitions.

        Args:
            plan: which foot stands where and when; its swings are the tracking controller's in height.
            start_s: begin, the plan's clock.
            start: where the body is then; None: on the reference, with the velocity that the swing asks for.
            body: reference of the body; None: the tracking controller's for the plan.
            elevation: the ground, for swings and the check of their clearance; None: nothing is known of it.
            regions: that footholds must lie in; None: not checked.
            window: transitions that are optimised at once; None: as the settings say.

        Raises:
            PlannerError: values that are not finite, arrays of another shape, or a rotation that is none.
        """
        began = time.perf_counter()
        self._check(start_s, start)
        end_s = window_end(plan, start_s, window or self.settings.window, _REST_S)
        knots = make_knots(plan, self.robot.geometry, start_s, end_s, self.settings.knot_s, elevation)
        n = len(knots.times) - 1
        if body is None:
            body = self._maker.from_contacts(plan, start_s=start_s, horizon_s=end_s - start_s, elevation=elevation)
        if self._work is None or len(self._work.inputs) < n:
            self._work = make_workspace(max(n, 80))
        work = self._work
        course = make_course(self.robot.geometry, self._model, work.tree, body, knots, self.robot.com)
        lacking, steer = swing_demand(plan, body, end_s)
        course.states[n, :3] += lacking
        if start is None:
            course.states[0, :3] += swing_demand(plan, body, start_s)[0]
        else:
            course.states[0, :9] = np.concatenate([start.velocity, start.momentum, start.com])
            course.rotations[0] = start.rotation
            stand_first(self.robot.geometry, self._model, work.tree, knots, course, self.robot.com)
        work.states[: n + 1], work.rotations[: n + 1] = course.states, course.rotations
        work.inputs[:n] = course.inputs
        steer *= math.sqrt(self.settings.capture * _SIZE_M / self._maker.height)
        problem = SwingProblem(
            np.diff(knots.times), knots.standing, knots.fixed, knots.target, knots.contact, knots.axes, course.states,
            course.rotations, course.inputs, self._weights, steer, self.settings.foot, self._limits,
        )  # fmt: skip
        answer, end, worst, broken = self._solved(problem, knots, course, elevation, self.settings.passes)
        left = self.settings.passes - end.passes
        if broken is not None and broken[0] in _BOUNDED and left > 0:
            stiff = self._limits._replace(
                barrier=_HIGHER * self._limits.barrier, smooth=_NARROWER * self._limits.smooth
            )
            before = end.passes
            answer, end, worst, broken = self._solved(problem._replace(limits=stiff), knots, course, elevation, left)
            end = end._replace(passes=before + end.passes)
        broken = broken or _off_region(knots, work.feet, self.robot.geometry.foot_radius, regions)
        return self._answer(knots, answer, broken, end, worst, began)

    def _solved(
        self, problem: SwingProblem, knots: Knots, course: Course, elevation: HeightMap | None, passes: int
    ) -> tuple[Course, _End, dict[str, float], tuple[str, str] | None]:
        """Solve from the iterate at hand; the answer, how it ended, the worst of each rule and the one broken."""
        work, n = self._work, len(problem.inputs)
        assert work is not None
        end = _End(*solve(self._model, problem, work, passes, self.settings.converged))
        answer = Course(work.states[: n + 1], work.rotations[: n + 1], work.inputs[:n], course.reached)
        worst, broken = self._judged(knots, answer, course.rotations, elevation)
        if broken is not None and end.violation > _MISSED and (why := self._out_of_reach(course, knots)):
            broken = ("reach", why)
        elif end.ended == SINGULAR:
            broken = ("solver", "solver: a leg is singular on the way")
        return answer, end, worst, broken

    def warm_up(self) -> None:
        """Compile, or load, what :meth:`optimise` calls."""
        from legtool_runtime.tracking.gaits import GaitTiming, plan_from_gait

        feet = self.robot.geometry.stance * [1.0, 1.0, 0.0]
        plan = plan_from_gait(GaitTiming.trot(), [np.stack([f, f]) for f in feet], start_s=0.0)
        self.optimise(plan, start_s=0.0)

    def _check(self, start_s: float, start: SwingState | None) -> None:
        if not math.isfinite(start_s):
            raise PlannerError(f"swing optimisation: start at {start_s} s, expected a finite time")
        if start is None:
            return
        for name, value, shape in zip(SwingState._fields, start, ((3,), (3,), (3,), (3, 3)), strict=True):
            finite(f"swing optimisation: start's {name}", value, shape, PlannerError)
        if not is_rotation(start.rotation):
            raise PlannerError(f"swing optimisation: start's rotation {start.rotation.tolist()} is no rotation")

    def _out_of_reach(self, course: Course, knots: Knots) -> str:
        bad = np.argwhere(~course.reached)
        if not len(bad):
            return ""
        k, leg = bad[0]
        place = np.round(knots.target[k, leg], 3).tolist()
        return f"reach: {LEGS[leg]} does not get to {place} m at {knots.times[k]:.2f} s"

    def _judged(
        self, knots: Knots, answer: Course, wanted: Array, elevation: HeightMap | None
    ) -> tuple[dict[str, float], tuple[str, str] | None]:
        """The worst of each rule, and the first one that is broken with its reason."""
        n, s, weight = len(answer.inputs), self.settings, self.robot.mass * GRAVITY
        states = answer.states
        judged = Judged(
            knots.times, states[:, 6:9].copy(), states[:, 0:3].copy(), states[:, 3:6].copy(),
            answer.rotations, wanted, states[:, 12:].copy(),
            weight * answer.inputs[:, :12].reshape(n, 4, 3), answer.inputs[:, 12:].copy(), knots.standing,
            knots.contact, knots.axes[:, :, 2].copy(), knots.phase, _ends(knots),
        )  # fmt: skip
        joints = self.robot.geometry.joint_limits.reshape(12, 2)
        bounds = np.stack([joints[:, 0], joints[:, 1], self.robot.torque_limit.ravel()])
        worst = Worst(np.zeros(len(RULES)), np.zeros(len(RULES), np.int64))
        of_settings = (s.friction, self.joint_speed, s.clearance)
        judge(self._model, judged, ground_of(elevation), bounds, of_settings, self._terms, worst)
        most = np.array([s.defect, s.slip, 1e-6, 1e-9, 1e-6, 1.0, 1.0, -s.clearance, s.off_tilt])
        values = dict(zip(RULES, worst.values.tolist(), strict=True))
        for name in _FIRST:  # a motion that is not solved breaks many rules; these say most
            rule = RULES.index(name)
            if not worst.values[rule] <= most[rule]:
                why = (
                    f"{name}: {worst.values[rule]:.4g}{_UNITS[rule]} at {knots.times[worst.knots[rule]]:.2f} s, "
                    f"at most {most[rule]:.4g} is allowed"
                )
                return values, (name, why)
        return values, None

    def _answer(
        self, knots: Knots, answer: Course, broken: tuple[str, str] | None, end: _End, worst: dict[str, float],
        began: float,
    ) -> SwingMotion:  # fmt: skip
        n, states = len(answer.inputs), answer.states
        assert self._work is not None
        feet, base = np.empty((n + 1, 4, 3)), np.empty((n + 1, 3))
        places(self._model, states, answer.rotations, self._work.tree, feet, base)
        rule, reason = broken or ("", "")
        return SwingMotion(
            broken is None, rule, reason, knots.times, states[:, 6:9].copy(), states[:, 0:3].copy(),
            states[:, 3:6].copy(), base, answer.rotations.copy(), states[:, 12:].copy(),
            self.robot.mass * GRAVITY * answer.inputs[:, :12].reshape(n, 4, 3), answer.inputs[:, 12:].copy(), feet,
            knots.standing, end.ended == CONVERGED, end.passes, end.cost, worst, time.perf_counter() - began,
        )  # fmt: skip


def _ends(knots: Knots) -> Array:
    """(n, 4, 2, 3) where the swing that a foot is in begins and ends; its own place where it is in none."""
    n = len(knots.standing)
    out = np.repeat(knots.target[:n, :, None], 2, axis=2)
    for leg in range(4):
        first = 0
        while first < n:
            last = first
            while last + 1 < n and knots.standing[last + 1, leg] == knots.standing[first, leg]:
                last += 1
            if not knots.standing[first, leg]:
                out[first : last + 1, leg, 0] = knots.target[first, leg]
                out[first : last + 1, leg, 1] = knots.target[last + 1, leg]
            first = last + 1
    return out


def _off_region(knots: Knots, feet: Array, radius: float, regions: Regions | None) -> tuple[str, str] | None:
    """The first touchdown that lies in no region."""
    for k, leg, stance in knots.landings:
        place = feet[k, leg] - radius * stance.normal
        if regions is not None and not _inside(place, regions):
            where = np.round(place, 3).tolist()
            return "polygon", f"polygon: {LEGS[leg]} comes to stand at {where} m, in no region"
    return None


def _inside(place: Array, regions: Regions) -> bool:
    """Whether a contact point (3,) lies on the polygon of some region."""
    for pose, corners in zip(regions.poses, regions.boundaries, strict=True):
        u, v, off = pose[:3, :3].T @ (place - pose[:3, 3])
        if abs(off) > _ON_PLANE_M:
            continue
        ahead = np.roll(corners, -1, axis=0) - corners
        if (ahead[:, 0] * (v - corners[:, 1]) - ahead[:, 1] * (u - corners[:, 0]) >= -1e-9).all():
            return True
    return False
