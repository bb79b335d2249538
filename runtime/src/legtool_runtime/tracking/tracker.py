"""The tracking controller: feet go where a contact plan puts them, and the body follows.

At every tick: which feet stand, by the plan and by what they feel; every 20 ms and at every lift-off and touchdown a
body reference and a preview; whole-body control for the torques. A foot that touches early stands at once; while one
is late, the plan's clock stands still and the foot goes on down. What a walk may bring never raises: where it cannot go
on, the robot comes to a stand, feet in the air finish their swings, and :attr:`Tracker.fault` says why.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.errors import TrackingError
from legtool_runtime.robot import LEGS
from legtool_runtime.rotations import angles_of
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.assembly import Gains, References
from legtool_runtime.tracking.body_reference import BodyReference, PoseFilter, ReferenceMaker
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance
from legtool_runtime.tracking.dynamics import GRAVITY, FullState, dynamics_terms, make_terms
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.preview import BodyState, Preview, PreviewSolution
from legtool_runtime.tracking.reassign import Footholds, reassigned
from legtool_runtime.tracking.settings import PreviewSettings, TrackerSettings
from legtool_runtime.tracking.swing import TimedSwing
from legtool_runtime.tracking.touchdown import TouchdownRules, Touchdowns
from legtool_runtime.tracking.wanted import EASE_S, WAIT_S, delay, lifted, want
from legtool_runtime.tracking.watch import Watch
from legtool_runtime.tracking.whole_body import Answer, WholeBody

Array = NDArray[np.float64]

#: Height of the centre of mass over the feet for which lengths below are written [m].
SIZE_M = 0.55
#: The horizon's reference is made for this much more than the preview's nodes [s].
_BEYOND_S = 0.1
#: A plan's stances are kept for so long after they are over: the body reference smooths over them [s].
_KEEP_S = 2.5
#: After so long, a late foot hurries, and within so long it goes down so many times as fast.
_PATIENT_S, _HURRY_S, _FASTER = 0.015, 0.05, 3.0
#: A foot that is late for so long, and so far beside its foothold (ANYmal C), is caught: it swings again, for so long
#: at least, and so many times at most [s, m, s].
_CAUGHT_S, _CAUGHT_M, _AGAIN_S, _AGAIN = 0.15, 0.05, 0.35, 3
#: Footholds nearer to each other than this are one [m].
_SAME_M = 1e-6
#: A body whose c + v/ω is off its reference by more than this was pushed: the clock of the plan runs faster in swings,
#: by so much per metre and at most [m, 1/m, 1].
_PUSHED_M, _QUICKER, _QUICKEST = 0.07, 4.0, 1.4
#: While all stand and it is off by more than this, the clock stands still, at most for so long: on two feet it would
#: grow by exp(ω t), six times in a swing of a trot [m, s].
_STEADY_M, _HELD_S = 0.06, 0.8
#: Feet in the air are given other footholds up to this phase of their swings, and again after so long [s].
_DECIDED, _CHOOSE_S = 0.7, 0.08
#: A foot that lost the ground with less than this left of its stance, on a clock that runs, need not search for it [s].
_ENDING_S = 0.08


class MeasuredState(NamedTuple):
    """What the robot measures at a tick, of the shapes in :class:`~.dynamics.FullState`; ``forces`` (4,) normal, on its
    feet [N]."""

    position: Array
    orientation: Array
    joints: Array
    velocity: Array
    forces: Array


class Landing(NamedTuple):
    """A foot that came to stand: when by the robot's clock [s], where it should (3,), where it did (3,), world frame
    [m], the normal of the ground there (3,), and at which phase of its swing."""

    leg: int
    time_s: float
    planned: Array
    place: Array
    normal: Array
    phase: float

    @property
    def error_m(self) -> float:
        """Horizontal distance of the place from the planned one."""
        return float(np.hypot(*(self.place - self.planned)[:2]))


class Tracker:
    """Walks contact plans with one robot.

    Attributes:
        robot: whose torques it gives.
        plan: what is left of the plan, changed by what feet did.
        clock_s: of the plan; it stands still while a foot is late.
        contact: (4,) which feet stand.
        terms: of the dynamics as measured at the last tick: centre of mass, its velocity, rotation, feet.
        landings: of the walk so far.
        fault: why it stopped; empty while it walks.
        wanted: what whole-body control was asked for at the last tick; None before the first.
        answer: what it decided then; overwritten at the next tick.
        reference: of the body, of the last preview.
        preview: the last one.
        footholds: other places where feet may stand, for a body that is off its way; None: they go where they are to.
        reassigned: how often feet in the air were given others of them.
    """

    def __init__(
        self,
        robot: TrackedRobot,
        plan: ContactPlan,
        *,
        settings: TrackerSettings | None = None,
        gains: Gains | None = None,
        preview: PreviewSettings | None = None,
        rules: TouchdownRules | None = None,
        elevation: HeightMap | None = None,
        lead: Callable[[Tracker], None] | None = None,
        references: ReferenceMaker | None = None,
    ) -> None:
        """Prepare to walk a plan; its clock begins at the first tick's time.

        Args:
            robot: geometry, masses and limits.
            plan: whole, or the first part of one that :meth:`follow` goes on with.
            settings: of tracking.
            gains: of whole-body control.
            preview: settings of the preview; None: for the gait that the plan walks.
            rules: of touchdowns; None: the usual ones, above the noise that the settings name.
            elevation: the ground, to keep legs off it and to judge touchdowns by; None: nothing is known of it.
            lead: called at each tick before feet lift and land: it may :meth:`follow` another plan and :meth:`aim` at
                another pose, see :class:`.gait_tracker.GaitTracker`. A TrackingError that it raises stops the robot.
            references: makes the body's reference of the plan; None: what the feet imply.

        Raises:
            TrackingError: the plan puts a foot out of reach.
            RobotError: a gain that cannot be used.
        """
        self.robot, self.settings = robot, settings or TrackerSettings()
        self.plan = ContactPlan(plan.stances, robot=robot.geometry)
        self.elevation = elevation
        self.lead = lead
        self.clock_s, self.fault = -math.inf, ""
        self.contact = np.ones(4, np.bool_)
        self.landings: list[Landing] = []
        self.wanted: References | None = None
        self.answer: Answer | None = None
        self.reference: BodyReference | None = None
        self.preview: PreviewSolution | None = None
        self._maker = references or ReferenceMaker(robot.geometry, com_offset=robot.com)
        size = self._maker.height / SIZE_M
        self._size, self._omega = size, math.sqrt(GRAVITY / self._maker.height)
        crawls = _crawls(plan) if self.settings.crawls is None else self.settings.crawls
        usual = PreviewSettings.level() if self.settings.held == "trunk" else PreviewSettings()
        chosen = preview or (PreviewSettings.crawl() if crawls else usual)
        chosen = replace(chosen, friction=min(chosen.friction, 0.95 * self.settings.friction))
        self._preview = Preview(mass=robot.mass, inertia=robot.inertia, height=self._maker.height, settings=chosen)
        self._whole = WholeBody(robot, gains)
        rules = rules or TouchdownRules.above_noise(self.settings.force_noise)
        self._touch = Touchdowns(weight=robot.mass * GRAVITY, radius=robot.geometry.foot_radius, rules=rules)
        self._watch = Watch(robot.torque_limit)
        self._model, self.terms = robot.model(), make_terms()
        self._normals = np.tile([0.0, 0.0, 1.0], (4, 1))
        self._swings: list[TimedSwing | None] = [None] * 4
        self._searched_s = np.zeros(4)
        self._again = np.zeros(4, np.int64)
        self._places = np.full((4, 3), np.nan)
        self._last = None
        self._replan_in_s, self._since_s = 0.0, 0.0
        #: How far the body's reference is ahead of a clock that has been stopped [s].
        self._ahead_s = 0.0
        self._rate, self._held_s = 1.0, 0.0
        self.footholds: Footholds | None = None
        self.reassigned, self._chosen_s = 0, -math.inf
        self._torques = np.zeros(12)
        self._pose: tuple[PoseFilter, Array] | None = None

    _last: MeasuredState | None

    def follow(self, plan: ContactPlan, *, checked: bool = False) -> None:
        """Go on by another plan, on this tracker's clock; swings on the way bend to their new places.

        A plan that contradicts the feet that stand now lets them stand where they are.

        Args:
            plan: to follow.
            checked: its footholds are known to be within reach.

        Raises:
            TrackingError: a foothold is out of reach; the robot goes on as before.
        """
        self.plan = plan if checked else ContactPlan(plan.stances, robot=self.robot.geometry)
        for leg in range(4):
            swing, following = self._swings[leg], self.plan.next(leg, self.clock_s)
            phase = self.phase(leg)
            if swing is None or following is None or phase >= 1.0:
                continue
            end = self._end(following)
            if float(np.abs(end - swing.foothold).max()) > _SAME_M:
                self._swings[leg] = swing.adjust(end, phase=max(phase, 1e-6))
        self._replan_in_s = 0.0

    def aim(self, pose: ArrayLike | None) -> None:
        """Hold the trunk at (3,) height of its origin, world frame [m], roll, pitch [rad], gone over to smoothly
        (:class:`.PoseFilter`) and within what the standing legs reach; None: as the feet imply.

        Raises:
            TrackingError: a pose that is not three finite numbers.
        """
        if pose is None:
            self._pose = None
            return
        target = np.asarray(pose, dtype=np.float64)
        if target.shape != (3,) or not np.isfinite(target).all():
            raise TrackingError(f"pose {target.tolist()}: expected finite height, roll and pitch")
        if self._pose is not None:
            now = self._pose[0]
        elif self._last is None:
            now = PoseFilter(target.copy(), np.zeros(3))
        else:
            roll, pitch, _ = angles_of(self.terms.rotation)
            now = PoseFilter(np.array([self._last.position[2], roll, pitch]), np.zeros(3))
        self._pose = now, target

    @property
    def filtered_pose(self) -> Array | None:
        """(3,) height [m], roll, pitch [rad] on the way to what is aimed at; None where nothing is."""
        return None if self._pose is None else self._pose[0].value

    @property
    def finished(self) -> bool:
        """Whether the plan's last event is over and all feet stand."""
        return bool(self.clock_s >= self.plan.end_s and self.contact.all())

    def step(self, state: MeasuredState, time_s: float) -> Array:
        """Run one tick.

        Args:
            state: measured now.
            time_s: by the robot's clock.

        Returns:
            (12,) motor torques [Nm], legs FL, FR, RL, RR × hip, thigh, knee; finite and within the limits whatever is
            measured.
        """
        dt, wrong = self._watch.tick(state, time_s)
        if wrong:
            self.stop(wrong)
        if self._watch.usable:
            self._last = MeasuredState(*(np.array(part, dtype=np.float64, order="C") for part in state))
        elif self._last is None:
            return self._torques
        if self.clock_s == -math.inf:
            self.clock_s = (time_s if math.isfinite(time_s) else 0.0) - dt
        body, changed = FullState(*self._last[:4]), False
        dynamics_terms(self._model, body, self._normals, self.terms)
        if self._watch.usable:  # else nothing can be controlled by it: hold what carried the robot
            try:
                changed = self._follow_plan(dt, time_s)
            except TrackingError as problem:  # nothing raises in mid-walk
                self.stop(str(problem))
                changed = True
        self._since_s += dt
        self._replan_in_s -= dt
        if changed or self._replan_in_s <= 1e-9 or self.preview is None:
            self._plan_ahead()
        answer = self._whole.control(body, self._references())
        self.answer = answer
        self._torques = answer.torques.copy()
        if wrong := self._watch.judge(answer, self.preview, self.terms.rotation, dt):
            self.stop(wrong)
        return self._torques

    def _follow_plan(self, dt: float, time_s: float) -> bool:
        """The clock, feet that lift and land, and where they go; whether any lifted or landed."""
        assert self._last is not None
        self._advance(dt)
        if self.lead is not None and not self.fault:
            self.lead(self)
        changed = self._feet(self._last.forces, dt, time_s)
        self._reassign()
        return changed

    def _advance(self, dt: float) -> None:
        """The plan's clock runs unless a foot is late."""
        if self._pose is not None:
            self._pose = self._pose[0].after(self._pose[1], dt), self._pose[1]
        late = self.late()
        self._rate = 0.0 if late.any() else self._clock_rate(dt)
        ran = self._rate * dt
        self.clock_s += ran
        self._ahead_s += dt * (1.0 - self._ahead_s / EASE_S) - ran
        self._searched_s[late] += dt
        if (self._searched_s > _CAUGHT_S).any():
            self._swing_again(late)
        longest = int(np.argmax(self._searched_s))
        if self._searched_s[longest] > self._watch.limits.search_s:
            self.stop(f"{LEGS[longest]} found no ground where it was to stand; the plan waits for it")

    def _clock_rate(self, dt: float) -> float:
        """How fast the plan's clock runs while no foot is late: 1 but for a body that was pushed.

        Feet that come down sooner catch it before it is beyond them, and on four feet it comes back.
        """
        if self.reference is None or self.lead is not None:  # who leads chooses footholds that catch the body
            return 1.0
        off = float(np.hypot(*self._diverges())) / self._size
        if not self.contact.all():
            self._held_s = 0.0
            return 1.0 + min(max(_QUICKER * (off - _PUSHED_M), 0.0), _QUICKEST - 1.0)
        if off <= _STEADY_M or self._held_s >= _HELD_S:
            return 1.0
        self._held_s += dt
        return 0.0

    def _diverges(self) -> Array:
        """(2,) by how much c + v/ω is off its reference, world frame [m]."""
        assert self.reference is not None
        point = self.reference.at(self.clock_s)
        off = self.terms.com - point.position + (self.terms.com_velocity - point.velocity) / self._omega
        return np.asarray(off[:2])

    def _reassign(self) -> None:
        """Let feet in the air land elsewhere where that catches the body (:mod:`.reassign`)."""
        least = self.settings.reassign_m
        if least is None or self.footholds is None or self.reference is None:
            return
        if self.clock_s < self._chosen_s + _CHOOSE_S:
            return
        early = [leg for leg in range(4) if not self.contact[leg] and self._swings[leg] and self.phase(leg) < _DECIDED]
        if not early:
            return
        off = self._diverges()
        if float(np.hypot(*off)) <= least * self._size:
            return
        plan = reassigned(
            self.plan, self.clock_s, off, omega=self._omega, legs=early, footholds=self.footholds,
            robot=self.robot.geometry, size=self._size,
        )  # fmt: skip
        if plan is not None:
            self._chosen_s = self.clock_s
            self.reassigned += 1
            self.follow(plan, checked=True)

    def late(self) -> NDArray[np.bool_]:
        """(4,) feet that should stand by now and do not."""
        plan, now = self.plan, self.clock_s
        stand = self.contact.tolist()
        return np.array([not stand[leg] and plan.index(leg, now) is not None for leg in range(4)])

    def phase(self, leg: int) -> float:
        """Of a leg's swing; above 1 while it is late."""
        swing = self._swings[leg]
        if swing is None:
            return 0.0
        if self.plan.index(leg, self.clock_s) is None:
            return self.plan.swing_phase(leg, self.clock_s)
        return 1.0 + self._search_pace(leg)[0] / swing.duration_s

    def _search_pace(self, leg: int) -> tuple[float, float]:
        """How much of its search a late foot has done, as time at the speed of touchdown [s], and how much faster it
        is by now: a body that waits falls."""
        late = max(float(self._searched_s[leg]) - _PATIENT_S, 0.0)
        hurry = min(late / _HURRY_S, 1.0)
        more = 0.5 * hurry * hurry * _HURRY_S + max(late - _HURRY_S, 0.0)
        return float(self._searched_s[leg]) + (_FASTER - 1.0) * more, 1.0 + (_FASTER - 1.0) * hurry

    def _feet(self, forces: Array, dt: float, time_s: float) -> bool:
        """Lift and land feet; whether any did."""
        changed = False
        for leg in range(4):
            if self.contact[leg]:
                continue
            force, phase, swing = float(forces[leg]), self.phase(leg), self._swings[leg]
            if self._touch.lands(
                leg, phase=phase, force=force, foot=self.terms.feet[leg], elevation=self.elevation,
                foothold=None if swing is None else swing.foothold,
            ):  # fmt: skip
                self._land(leg, phase, time_s)
                changed = True
        late = self.late().any()
        for leg in np.flatnonzero(self.contact).tolist():
            k = self.plan.index(leg, self.clock_s)
            if k is None and not late:
                self._lift(leg)
                changed = True
            elif (
                k is not None
                and math.isfinite(forces[leg])  # a foot is not lost because its sensor is
                and not self._touch.stands(leg, force=float(forces[leg]), dt=dt)
                and (self._rate == 0.0 or self.plan.stances[leg][k].end_s - self.clock_s > _ENDING_S)
            ):
                self._search(leg)
                changed = True
        return changed

    def _land(self, leg: int, phase: float, time_s: float) -> None:
        stance = self.plan.current(leg, self.clock_s) or self.plan.next(leg, self.clock_s)
        assert stance is not None
        place = self.terms.feet[leg] - self.robot.geometry.foot_radius * stance.normal
        self.landings.append(Landing(leg, time_s, stance.place.copy(), place, stance.normal, phase))
        self.contact[leg], self._swings[leg], self._searched_s[leg], self._again[leg] = True, None, 0.0, 0
        self._places[leg] = place
        self.plan = self.plan.touched_down(leg, self.clock_s, place).since(self.clock_s - _KEEP_S)

    def _lift(self, leg: int) -> None:
        """Begin a swing from where the foot is."""
        following = self.plan.next(leg, self.clock_s)
        if following is None:
            return
        self.contact[leg], self._searched_s[leg], self._places[leg] = False, 0.0, np.nan
        self._touch.lifted(leg)
        duration = following.begin_s - self.plan.lift_off_s(leg, self.clock_s)
        self._normals[leg] = following.normal
        self._swings[leg] = self._swing(self.terms.feet[leg].copy(), self._end(following), duration)

    def _search(self, leg: int) -> None:
        """A standing foot has lost the ground: it goes down for it."""
        foot = self.terms.feet[leg].copy()
        self.contact[leg], self._searched_s[leg], self._places[leg] = False, 0.0, np.nan
        self._touch.lifted(leg)
        self._swings[leg] = replace(self._swing(foot, foot, 0.2), height_m=0.0, bends=())

    def _swing_again(self, late: NDArray[np.bool_]) -> None:
        """Free a late foot that is caught beside its foothold, at a riser or a stone, by another swing of all that are
        in the air."""
        footholds = np.array([self.terms.feet[leg] if s is None else s.foothold for leg, s in enumerate(self._swings)])
        off = np.hypot(*(footholds - self.terms.feet)[:, :2].T)
        caught = late & (self._searched_s > _CAUGHT_S) & (off > _CAUGHT_M * self._size) & (self._again < _AGAIN)
        legs = np.flatnonzero(~self.contact).tolist()
        if not caught.any() or any(self.plan.neighbour(leg, self.clock_s) == 0 for leg in legs):
            return
        duration = max(_AGAIN_S, *(swing.duration_s for swing in self._swings if swing is not None))
        self._again[caught] += 1
        self._searched_s[:] = 0.0
        self.plan = self.plan.swung_again(legs, self.clock_s, duration)
        for leg in legs:
            self._swings[leg] = self._swing(self.terms.feet[leg].copy(), footholds[leg], duration)

    def _swing(self, start: Array, end: Array, duration_s: float) -> TimedSwing:
        given, size = self.settings, self._size
        swing = TimedSwing(
            start, end, given.swing_height_m * size, duration_s=min(max(duration_s, 0.05), 10.0),
            profile=given.swing_profile, search_speed=given.search_speed * math.sqrt(size),
            search_depth_m=given.search_depth_m * size,
        )  # fmt: skip
        return swing if self.elevation is None else swing.clear_of(
            self.elevation, radius=self.robot.geometry.foot_radius
        )[0]  # fmt: skip

    def _end(self, stance: Stance) -> Array:
        """Where the foot's centre goes to stand."""
        end: Array = stance.place + (self.robot.geometry.foot_radius - self.settings.aim_below_m) * stance.normal
        return end

    def _plan_ahead(self) -> None:
        """A new body reference and preview, from what is measured."""
        terms = self.terms
        horizon = self._preview.settings.nodes * self._preview.settings.node_s + _BEYOND_S
        late, wait = self.late(), self._wait_s()
        self.reference = self._waiting(
            self._maker.from_contacts(
                self.plan, start_s=self.clock_s, horizon_s=horizon, poses=self._poses, elevation=self.elevation
            ),
            wait,
        )
        plan = self.plan.delayed(wait, after_s=self.clock_s) if wait else self.plan
        assert self._last is not None
        spin = terms.rotation @ self._last.velocity[3:6]
        com, velocity = terms.com.copy(), terms.com_velocity.copy()
        height, rate = self._lifted()
        com[2] -= height
        velocity[2] -= rate
        now = BodyState(com, velocity, terms.rotation.copy(), spin)
        self.preview = self._preview.solve(
            now, self.reference, plan, self.clock_s,
            standing=self.contact, late=late, places=self._places,
        )  # fmt: skip
        if self.preview.solved:
            self._since_s = 0.0
        self._replan_in_s = self.settings.replan_s

    def _lifted(self) -> tuple[float, float]:
        """By how much the centre of mass is to be held higher than planned, see :func:`.wanted.lifted`."""
        if self.settings.held == "mass":
            return 0.0, 0.0
        assert self._last is not None
        terms, body = self.terms, self._last
        moving = (terms.com, terms.com_velocity, terms.rotation, body.position, body.velocity)
        return lifted(moving, self.robot.com, self._maker.legs, terms.feet, self.contact)

    @property
    def _poses(self) -> Callable[[Array], Array] | None:
        if self._pose is None:
            return None
        now, target = self._pose
        return lambda times: now.ahead(target, times)[:, 0]

    def _wait_s(self) -> float:
        """For how long the clock is expected to stand still from now on: a body that was pushed comes back first."""
        if self._rate > 0.0:
            return 0.0
        return WAIT_S if self.late().any() else max(_HELD_S - self._held_s, WAIT_S)

    def _waiting(self, reference: BodyReference, wait_s: float) -> BodyReference:
        """The reference of a body that stops while a foot is late, and gathers speed when the clock goes on."""
        if not wait_s and self._ahead_s < 1e-4:
            return reference
        control = np.empty_like(reference.control)
        delay(reference.start_s, reference.step_s, reference.control, self.clock_s, self._ahead_s, wait_s, control)
        return BodyReference(reference.start_s, reference.step_s, control)

    def _references(self) -> References:
        """What whole-body control is asked for."""
        assert self.reference is not None and self.preview is not None
        solution, reference = self.preview, self.reference
        com, orientation, turning, forces = np.empty((3, 3)), np.empty(4), np.empty((2, 3)), np.zeros((4, 3))
        motion = (solution.times_s, solution.position, solution.velocity, solution.acceleration)
        spline = (reference.start_s, reference.step_s, reference.control)
        want(
            motion, solution.angular_acceleration, solution.forces, spline, self._since_s, self.contact,
            com, orientation, turning, forces,
        )  # fmt: skip
        height, rate = self._lifted()
        com[0, 2] += height
        com[1, 2] += rate
        swing = np.zeros((4, 3, 3))
        for leg in range(4):
            path = self._swings[leg]
            if path is not None and not self.contact[leg]:
                swing[leg] = path.at(self.phase(leg))
                pace = max(self._search_pace(leg)[1], self._rate)
                swing[leg, 1] *= pace
                swing[leg, 2] *= pace * pace
                continue
            stance = self.plan.current(leg, self.clock_s) or self.plan.last(leg, self.clock_s)
            if stance is not None:
                self._normals[leg] = stance.normal
        self.wanted = References(
            com=com,
            orientation=orientation,
            turning=turning,
            stance=self.contact.copy(),
            swing=swing,
            forces=forces,
            normals=self._normals.copy(),
            friction=np.full(4, self.settings.friction),
        )
        return self.wanted

    def stop(self, why: str) -> None:
        """Come to a stand, and keep the reason as :attr:`fault`: feet in the air land where they were to land, and no
        foot lifts any more."""
        if self.fault:
            return
        self.fault = why
        rows = []
        for stances in self.plan.stances:
            following = next((k for k, s in enumerate(stances) if self.clock_s < s.end_s), len(stances) - 1)
            rows.append([*stances[:following], replace(stances[following], end_s=math.inf)])
        self.plan = ContactPlan(rows)
        self._replan_in_s = 0.0


def _crawls(plan: ContactPlan) -> bool:
    """Whether no two legs ever swing at a time."""
    events = plan.events()
    middles = [0.5 * (a + b) for a, b in itertools.pairwise(events)]
    swinging = [int((~plan.standing(t)).sum()) for t in middles]
    return bool(swinging) and max(swinging) == 1
