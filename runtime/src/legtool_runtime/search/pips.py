"""The planner of QuadPiPS as a chain: regions, candidates, torso path, footholds, contact plan; one call a frame."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.checks import finite, instance
from legtool_runtime.errors import LegtoolError, PlannerError
from legtool_runtime.perception.regions import Regions
from legtool_runtime.robot import LEGS, Robot
from legtool_runtime.search.aims import Aim, aim_along, leads_out_of_sight, look_at, turn_along
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
from legtool_runtime.search.recall import Recall
from legtool_runtime.search.settings import PipsSettings, size_of
from legtool_runtime.search.supports import Supports
from legtool_runtime.search.surface import Surface
from legtool_runtime.search.torso import TorsoPath, TorsoPlanner
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
#: Before it does so, torso poses are taken whose ideal feet are so many times as far from footholds: the support is
#: only a guess at where footholds will be found.
_WIDER = (1.0, 1.5, 2.0)
#: A robot that stands and has found no way on takes footholds so many times as near to edges.
_TIGHT = 0.75
#: A robot that has stood for so long tries again, so often: noise gives other regions [s].
_AGAIN_S, _TRIES = 5.0, 3
#: It turns towards a goal so many times while no ground leads nearer, or it would turn to and fro before a wall.
_LOOKS = 6
#: A search that led nowhere for want of time is followed by one with so many times as much, while the robot stands.
_MORE = 4
#: A search that only a clock ends takes so long at most, for a robot that stands, or its usual time [s].
_LONGEST_S = 1.0
#: What a search that the deadline ended counts among the failures, if the robot has no more time.
_LATE = 0.25
#: The end of the last torso path is held to until it is so many cells away.
_KEPT_CELLS = 3
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
            PlannerError: a height that the legs do not reach; no robot, or no settings.
            TrackingError: a centre of mass that is not three finite numbers.
        """
        instance("robot", robot, Robot, PlannerError)
        if settings is not None:
            instance("settings", settings, PipsSettings, PlannerError)
        self.robot, self.settings, self._size = robot, settings or PipsSettings.of(robot), size_of(robot)
        f, most = self.settings.feet, self.settings.patience
        self._patience = most if f.expansions is not None else max(1, min(most, int(_LONGEST_S / f.deadline_s)))
        self._torso = TorsoPlanner(robot, self.settings, com_offset=com_offset)
        self._feet = FootPlanner(robot, self.settings, com_offset=com_offset)
        self.reset()

    def reset(self) -> None:
        """Forget the past: goals given up, waypoints that led nowhere, refused transitions."""
        self._tabu: list[tuple[float, float, float, float]] = []
        self._refused: list[tuple[float, int]] = []
        self._share = 1.0
        self._gait: str | None = None
        self._kept: tuple[Doubles, Candidates] | None = None
        self._now_s = 0.0
        self._goal = np.full(2, np.nan)
        self._failures, self._least_m = 0.0, math.inf
        self._effort, self._wider, self._stands_s = 1, 0, math.inf
        self._recall, self._whole, self._tries, self._looks = Recall(), False, 0, 0
        self._looking, self._glances, self._drops = False, 0, False

    def warm_up(self) -> None:
        """Compile, or load, what a frame calls."""
        self._feet.warm_up()
        half, many = 0.125, 12  # tiles, so that the paper's mode walks, too
        corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
        poses = np.tile(np.eye(4), (many * many, 1, 1))
        places = half * (2.0 * np.arange(many) + 1.0 - many)
        poses[:, 0, 3], poses[:, 1, 3] = np.repeat(places, many), np.tile(places, many)
        zeros = np.zeros(many * many)
        numbers = np.arange(many * many)
        floor = Regions(
            poses, (corners,) * (many * many), zeros + 4.0 * half * half, zeros, zeros, zeros > 0.0, numbers, numbers
        )
        feet = self.robot.stance * [1.0, 1.0, 0.0]
        height, plan = self.robot.standing_height, None
        ground = HeightMap(np.zeros((40, 40), np.float32), 0.05, np.zeros(2))
        for frame in range(2):
            plan = self.plan(
                floor, position=[0, 0, height], yaw=0.0, feet=feet, goal=[3, 0], time_s=0.1 * frame, plan=plan,
                elevation=ground,
            ).plan  # fmt: skip
        self.refuse(feet, np.add(feet, (0.1, 0.0, 0.0)), 0.0)
        offered = self.settings.candidates
        found, surface = find_candidates(floor, position=np.array([0.0, 0.0, height]), settings=offered)
        found.near(feet[:1], 1).with_held(found, found.points[-1:], surface, offered)  # one that is offered no more
        self.reset()

    def refuse(self, before: ArrayLike, after: ArrayLike, time_s: float, *, ahead: bool = False) -> None:
        """Do not plan a transition again for some seconds: tracking could not walk it.

        Args:
            before: (4, 3) contact points, world frame [m].
            after: (4, 3) where it led.
            time_s: now.
            ahead: whether the plan that is walked holds it: of that no more is kept than what has begun.
        """
        self._drops |= ahead
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
            instance("pips: regions", regions, Regions, PlannerError)
            if elevation is not None:
                instance("pips: elevation", elevation, HeightMap, PlannerError)
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
        toward = 0.0 if goal_yaw is None else goal_yaw
        values = finite("pips: yaw, time, yaw at the goal", [yaw, time_s, toward], (3,), PlannerError)
        return _Frame(
            finite("pips: position", position, (3,), PlannerError), float(values[0]),
            finite("pips: feet", feet, (4, 3), PlannerError), np.tile([0.0, 0.0, 1.0], (4, 1)),
            finite("pips: goal", goal, (2,), PlannerError), None if goal_yaw is None else float(values[2]),
            float(values[1]),
        )  # fmt: skip

    def _plan(
        self, regions: Regions, frame: _Frame, now: ContactPlan, elevation: HeightMap | None, times: dict[str, float]
    ) -> PipsPlan:
        s, self._now_s = self.settings, frame.time_s
        timing = timing_of(self._gait or s.feet.gaits[0], self._size)
        kept = committed(now, frame.time_s + s.commit_s, timing.full_stance_s)
        feet, normals = last_places(kept.plan)
        start, heading = self._start(frame, feet)
        if np.hypot(*(frame.position[:2] - frame.goal)) <= s.goal_tolerance and self._faces(frame):
            return PipsPlan("reached", "", kept.plan, _differs(kept.plan, now))
        stands = not any(math.isfinite(r.begin_s) for r in remaining(now, frame.time_s))
        lost = stands and s.patience > 1 and (self._effort > 1 or self._failures > 0 or self._wider > 0)
        offered = s.candidates if not lost else replace(s.candidates, least_margin=_TIGHT * s.candidates.least_margin)
        with _Clock(times, "candidates"):
            found, surface = find_candidates(
                regions, position=start, settings=offered, trunk_width=trunk_width(self.robot), elevation=elevation
            )
        last = np.array([r.place for r in remaining(now, frame.time_s)]).reshape(-1, 3)
        if self._kept is not None:
            found = found.with_held(self._kept[1], last, surface, s.candidates)
        found = self._recalled(found, surface, stands, lost)
        if why := self._in_air(frame, now, surface):
            return PipsPlan("exhausted", why, kept.plan, _differs(kept.plan, now), found)
        with _Clock(times, "torso"):
            carried = found.with_feet(feet, normals, s.candidates.spacing)
            path, supports = self._way(carried, surface, (start, heading), frame)
        if why := self._given_up(frame, path):
            return self._stay(kept, now, frame, (found, surface), why, path)
        near = found.near(path.poses, s.candidates.most)
        problem = FootProblem(
            near, surface, feet, normals, path.poses[-1, :3], None, kept.swung, None, last,
            self._refusals(frame.time_s),
        )  # fmt: skip
        if path.status == "enclosed" or len(path.poses) < 2:
            looks = stands and s.patience > 1 and self._looks < _LOOKS
            look = look_at(frame.goal, path, s) if looks else None
            self._looks += look is not None
            if look is None:
                if stands and self._tabu and s.patience > 1 and self._tries < _TRIES:
                    self._tabu, self._tries = [], self._tries + 1  # the other ways are tried; begin again
                why = f"torso search: {path.left_m:.2f} m from the goal no pose that is nearer stands over ground"
                return self._stay(kept, now, frame, (found, surface), why, path)
            aim, steps = look, self._steps(problem, look, supports, path, stands, times)
        else:
            aim, steps = self._along(problem, supports, path, frame, stands, times)
        waypoint = aim.waypoint
        if steps.status == "found" and len(steps) == 0 and aim.ends:
            return PipsPlan("walking", "", kept.plan, _differs(kept.plan, now), near, path, steps, waypoint)
        if self._wants_more(steps, stands) or steps.status not in ("found", "partial") or len(steps) == 0:
            self._back_off(path, waypoint, steps, stands)
            self._kept = None
            why = f"foothold search: {steps.reason or 'the feet stand at the waypoint'}"
            return self._stay(kept, now, frame, (near, surface), why, path, steps, waypoint)
        if steps.status == "partial" and not self._drops and self._leads(kept, now, frame, found, surface):
            return PipsPlan("walking", steps.reason, now, False, near, path, steps, waypoint)
        self._whole, self._drops = steps.status == "found", False
        self._share, self._gait, self._effort = min(2.0 * self._share, 1.0), steps.gait, 1
        self._kept = path.poses[-1], near
        with _Clock(times, "plan"):
            new = contact_plan(steps, start_s=kept.ready_s, size=self._size, before=kept.plan)
        return PipsPlan("walking", steps.reason, new, True, near, path, steps, waypoint)

    def _leads(self, kept: Committed, now: ContactPlan, frame: _Frame, found: Candidates, surface: Surface) -> bool:
        """Whether the last plan led to its aim, and more of it is left than what has begun: a path that ends on the way
        is worth less, and plans that change at every frame end in stances that none of them would have taken."""
        ahead = [r for r in remaining(now, frame.time_s) if math.isfinite(r.begin_s)]
        more = len(ahead) > len([r for r in remaining(kept.plan, frame.time_s) if math.isfinite(r.begin_s)])
        return self._whole and more and all(_there(r.place, found, surface) for r in ahead)

    def _recalled(self, found: Candidates, surface: Surface, stands: bool, lost: bool) -> Candidates:
        """The candidates, with those of earlier frames where the robot stands and has found no way on."""
        if not stands or self.settings.patience == 1:
            self._recall.forget()
            return found
        self._recall.note(found)
        return self._recall.more(found, surface, self.settings.candidates.step) if lost else found

    def _way(
        self, carried: Candidates, surface: Surface, pose: tuple[Doubles, float], frame: _Frame
    ) -> tuple[TorsoPath, Supports]:
        """The torso's path and what carries it: by wider support where by the narrower one the robot is enclosed.

        Wider support is worth it where it leads nearer by a way, or to the goal: one at the edge of the ground, or
        beyond it, is reached from a pose whose feet stand shorter than the ideal ones.
        """
        position, heading = pose
        answer, least = None, self.settings.torso.least_way
        for wider in _WIDER[self._wider :]:
            supports = self._torso.supports(carried, surface, position, wider=wider)
            path = self._torso.plan(
                supports, position=position, yaw=heading, goal=frame.goal, goal_yaw=frame.goal_yaw,
                tabu=self._tabus(), kept=self._end(position),
            )  # fmt: skip
            there = np.hypot(*(path.poses[-1, :2] - frame.goal)) <= self.settings.goal_tolerance
            leads_on = path.status == "reached" or (path.status != "enclosed" and path.length_m >= least)
            leads_on = leads_on or (bool(there) and len(path.poses) > 1)
            if answer is None or (leads_on and (there or path.left_m < answer[0].left_m - least)):
                answer = path, supports
            if leads_on or self.settings.torso.support == 0.0 or self.settings.patience == 1:
                break
        assert answer is not None
        return answer

    def _end(self, position: Doubles) -> Doubles | None:
        """Where the last path ended, as a pose (4,), if that is far from the base (3,) still."""
        if self._kept is None:
            return None
        end = self._kept[0]
        return end if math.hypot(*(end[:2] - position[:2])) > _KEPT_CELLS * self.settings.torso.cell else None

    def _along(
        self, problem: FootProblem, supports: Supports, path: TorsoPath, frame: _Frame, stands: bool,
        times: dict[str, float],
    ) -> tuple[Aim, FootPlan]:  # fmt: skip
        """Footholds along the torso's path: to its end, or through the turn that it makes."""
        s = self.settings
        if (look := self._look_first(path, frame)) is not None:
            steps = self._steps(problem, look, supports, path, stands, times)
            if steps.status == "found" and len(steps):
                return look, steps
        aim = aim_along(path, self._share, goal=frame.goal, goal_yaw=frame.goal_yaw, settings=s)
        steps = self._steps(problem, aim, supports, path, stands, times)
        if steps.status != "found" and not aim.ends and (turn := turn_along(path, s)) is not None:
            turned = self._steps(problem, turn, supports, path, stands, times)
            if (turned.status == "found" and len(turned)) or steps.share < s.feet.enough:
                return turn, turned  # a path that ends short of the turn would undo what was turned so far
        return aim, steps

    def _look_first(self, path: TorsoPath, frame: _Frame) -> Aim | None:
        """A turn towards a goal that the camera does not see, where the path would lead past what is not seen."""
        if not leads_out_of_sight(path, frame.goal, self.settings):
            self._looking = False
            return None
        self._glances += not self._looking
        self._looking = True
        return look_at(frame.goal, path, self.settings) if self._glances <= _LOOKS else None

    def _steps(
        self, problem: FootProblem, aim: Aim, supports: Supports, path: TorsoPath, stands: bool,
        times: dict[str, float],
    ) -> FootPlan:  # fmt: skip
        """Footholds to an aim; a robot that stands has more time for them."""
        f, start = self.settings.feet, path.poses[0]
        field = None
        if self.settings.cost_to_go:
            with _Clock(times, "field"):
                field = self._torso.field(
                    supports, position=start[:3], yaw=start[3], waypoint=aim.waypoint,
                    yaw_matters=aim.yaw is not None, tolerance=aim.tolerance, yaw_tolerance=aim.yaw_tolerance,
                )  # fmt: skip
        asked = replace(
            problem, waypoint=aim.waypoint[:3], yaw=aim.yaw, field=field, tolerance=aim.tolerance,
            yaw_tolerance=aim.yaw_tolerance,
        )  # fmt: skip
        effort = self._effort if stands else 1
        with _Clock(times, "feet"):
            return self._feet.plan(
                asked,
                deadline_s=effort * f.deadline_s,
                most=None if f.expansions is None else effort * f.expansions,
            )

    def _given_up(self, frame: _Frame, path: TorsoPath) -> str:
        """Why the robot stands until it sees more: waypoints without footholds, one after the other; empty if not."""
        if not np.array_equal(frame.goal, self._goal):
            self._goal, self._least_m = frame.goal.copy(), math.inf
        if path.left_m < self._least_m - _NEARER_M:
            self._failures, self._least_m, self._wider = 0.0, path.left_m, 0
            self._tries, self._looks, self._glances = 0, 0, 0
        if self._failures < _FAILURES:
            return ""
        patient = self.settings.patience > 1
        if patient and self._wider + 1 < len(_WIDER):
            self._wider += 1
        elif patient and frame.time_s > self._stands_s + _AGAIN_S and self._tries < _TRIES:
            self._wider, self._tries = 0, self._tries + 1
        else:
            self._stands_s = min(self._stands_s, frame.time_s)
            return f"{_FAILURES} waypoints led nowhere; ground that is seen ends {path.left_m:.2f} m before the goal"
        self._failures, self._tabu, self._stands_s = 0.0, [], math.inf
        return ""

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
        self, kept: Committed, now: ContactPlan, frame: _Frame, seen: tuple[Candidates, Surface], why: str,
        path: TorsoPath, steps: FootPlan | None = None, waypoint: Doubles | None = None,
    ) -> PipsPlan:  # fmt: skip
        """The answer where nothing new leads on: the last plan while its footholds are there, else what has begun."""
        ahead = [r for r in remaining(now, frame.time_s) if math.isfinite(r.begin_s)]
        plan = now if all(_there(r.place, *seen) for r in ahead) else kept.plan
        if self._drops:
            plan = kept.plan
        changed = plan is not now and _differs(plan, now)
        return PipsPlan("exhausted", why, plan, changed, seen[0], path, steps, waypoint)

    def _wants_more(self, steps: FootPlan, stands: bool) -> bool:
        """Whether a robot that stands had better search longer than walk a path that ends far from the waypoint."""
        far = steps.status == "exhausted" or (steps.status == "partial" and steps.share < self.settings.feet.enough)
        return stands and far and steps.out_of_time and self._effort < self._patience

    def _back_off(self, path: TorsoPath, waypoint: Doubles, steps: FootPlan, stands: bool) -> None:
        """After a search that led nowhere: more time for the next one, if the robot stands; else a waypoint half as
        far; where that is too near, none like it for some time."""
        if self._wants_more(steps, stands):
            self._effort = min(_MORE * self._effort, self._patience)
            return
        late = steps.out_of_time and self._effort == 1
        self._share, self._effort = 0.5 * self._share, 1
        if self._share < _LEAST_SHARE or self._share * path.length_m < self.settings.torso.least_way:
            self._share = 1.0
            if stands or not late:
                self._failures += _LATE if late else 1.0
                self._tabu.append((float(waypoint[0]), float(waypoint[1]), float(waypoint[3]), self._now_s))

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
    """Adds the wall time of a block to a dictionary [s]."""

    def __init__(self, times: dict[str, float], name: str) -> None:
        self._times, self._name, self._began = times, name, 0

    def __enter__(self) -> None:
        self._began = time.perf_counter_ns()

    def __exit__(self, *_: object) -> None:
        self._times[self._name] = self._times.get(self._name, 0.0) + (time.perf_counter_ns() - self._began) * 1e-9


def _there(place: Doubles, found: Candidates, surface: Surface) -> bool:
    """Whether a foothold that was planned is there: a candidate, or ground at its height within a cell around it.

    Candidates along edges come and go with the noise of the edges: a plan that lost one with each would change in
    every frame.
    """
    if len(found):
        off = np.abs(found.points - place)
        if ((np.hypot(off[:, 0], off[:, 1]) <= _SAME_M) & (off[:, 2] <= _SAME_M)).any():
            return True
    i, j = np.floor(place[:2] / surface.cell).astype(np.int64) - surface.low
    around = surface.height[max(i - 1, 0) : max(i + 2, 0), max(j - 1, 0) : max(j + 2, 0)]
    return bool((np.abs(around - place[2]) <= _SAME_M).any())  # never where no region is


def _differs(a: ContactPlan, b: ContactPlan) -> bool:
    """Whether two plans have other stances."""
    return [len(r) for r in a.stances] != [len(r) for r in b.stances] or any(
        s.end_s != t.end_s for r, q in zip(a.stances, b.stances, strict=True) for s, t in zip(r, q, strict=True)
    )
