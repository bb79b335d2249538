"""The foothold search (QuadPiPS, section VI-C): from the feet as they stand to a waypoint, stance by stance.

The search is weighted A*, first with a great weight, then with smaller ones while time is left. It keeps its deadline
and always has an answer: a path, a partial one that comes nearer, or the rule that stopped it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.checks import finite
from legtool_runtime.errors import PlannerError
from legtool_runtime.motion.planning.clock import CLOCK, NEVER
from legtool_runtime.robot import LEGS, Robot
from legtool_runtime.search import feet_kernels as kernels
from legtool_runtime.search.body import TILT, body_of, legs_fit, scratch
from legtool_runtime.search.candidates import Candidates, keys_of
from legtool_runtime.search.feet_checks import move_signature
from legtool_runtime.search.feet_kernels import FOUND, OUT_OF_TIME
from legtool_runtime.search.feet_memory import MOST, N_EXPANDED, N_VALIDATED, feet_memory
from legtool_runtime.search.feet_problem import Gait, Task, World
from legtool_runtime.search.field_kernels import Field, no_field
from legtool_runtime.search.settings import GAITS, PipsSettings
from legtool_runtime.search.stances import RULES, SHAPE, rules_of, shape_of
from legtool_runtime.search.surface import Outlines, Surface, surface_of
from legtool_runtime.tracking.reach import level_pose

Doubles = NDArray[np.float64]
Status = Literal["found", "partial", "exhausted", "start_invalid"]

#: Kept of the deadline for what follows the search [ns].
_AFTER_NS = 150_000
#: A pass with a smaller weight is begun while so much of the deadline is left, as share.
_WORTH = 0.2
_LATE = "time or expansions ran out first"
#: A foothold of the last plan is the same one within so far, horizontally and in height [m].
_SAME = (0.03, 0.03)


@dataclass(frozen=True, eq=False)
class FootPlan:
    """A path of full stances, with the contact mode families between them.

    Attributes:
        status: ``found``; ``partial``: it ends nearer to the waypoint; ``exhausted``: nothing leads on;
            ``start_invalid``: the robot cannot stand as it is said to.
        reason: what stopped a search that did not find, in words.
        gait: that is walked.
        phases: (m + 1,) of the gait at each stance.
        stances: (m + 1, 4) rows of the candidates; the last four are the feet at the start.
        positions: (m + 1, 4, 3) contact points, world frame [m].
        normals: (m + 1, 4, 3) of the ground there.
        keys: (m + 1, 4) of the footholds.
        families: (m, 4) which feet stay in each transition: what the stances on its two sides share.
        torso: (m + 1, 6) nominal poses: x, y, z of the centre of mass [m], roll, pitch, yaw [rad].
        cost: of the path [m].
        share: how much of the way to the waypoint it comes, by the cost to go; 1 where it was found.
        out_of_time: whether the deadline came before the search's end.
        expanded, validated: stances, and transitions that were looked at in full.
        weight: of the heuristic with which it was found.
        first_s: wall time until the first path; planning_time_s: until the answer.
    """

    status: Status
    reason: str
    gait: str
    phases: NDArray[np.int64]
    stances: NDArray[np.int32]
    positions: Doubles
    normals: Doubles
    keys: NDArray[np.int64]
    families: NDArray[np.bool_]
    torso: Doubles
    cost: float
    share: float
    out_of_time: bool
    expanded: int
    validated: int
    weight: float
    first_s: float
    planning_time_s: float

    def __len__(self) -> int:
        return len(self.families)


@dataclass(frozen=True, eq=False)
class FootProblem:
    """What is asked for.

    Attributes:
        candidates: near the torso path.
        surface: the ground.
        feet: (4, 3) contact points at the start, world frame [m].
        normals: (4, 3) of the ground there.
        waypoint: (3,) where the base shall come to, world frame [m].
        yaw: its heading there [rad]; None: any.
        swung: legs that swung last; the gait goes on after them. None: it begins.
        field: cost to go of the torso; None: the straight way.
        last: (k, 3) footholds of the last plan, which are kept where that costs little.
        refused: signatures of transitions that were refused, see :meth:`FootPlanner.signature`.
        tolerance: of the waypoint [m]; None: that of the settings.
        yaw_tolerance: of the heading [rad]; None: that of the settings.
    """

    candidates: Candidates
    surface: Surface
    feet: Doubles
    normals: Doubles
    waypoint: Doubles
    yaw: float | None = None
    swung: Sequence[int] | None = None
    field: Field | None = None
    last: Doubles | None = None
    refused: Sequence[int] = ()
    tolerance: float | None = None
    yaw_tolerance: float | None = None


class FootPlanner:
    """Searches footholds for one robot; its memory is allocated once.

    Attributes:
        robot: whose feet.
        settings: of walkability and search.
    """

    def __init__(self, robot: Robot, settings: PipsSettings, *, com_offset: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Take the robot, the settings, and the centre of mass (3,) in the base frame [m]."""
        self.robot, self.settings = robot, settings
        self.body = body_of(robot, height_m=settings.height_m, com_offset=com_offset)
        self.rules = rules_of(settings.walkability, self.body.legs.hips)
        self._memory = feet_memory()
        self._number = 0

    def plan(
        self, problem: FootProblem, *, deadline_s: float | None = None, gaits: Sequence[str] | None = None,
        most: int | None = None,
    ) -> FootPlan:  # fmt: skip
        """Footholds towards a waypoint.

        Args:
            problem: what is asked for.
            deadline_s: after which there is an answer; None: that of the settings; infinite: none.
            gaits: to try, in order; None: those of the settings.
            most: stances that are expanded in one pass; None: as the settings say.

        Raises:
            PlannerError: values that are not finite, or too many candidates.
        """
        f = self.settings.feet
        began = time.clock_gettime_ns(CLOCK)
        limit = f.deadline_s if deadline_s is None else deadline_s
        most = (f.expansions or NEVER) if most is None else most
        end = NEVER if math.isinf(limit) else began + int(limit * 1e9) - _AFTER_NS
        names = list(gaits or f.gaits)
        world = self._world(problem)
        if why := self._start_fault(problem):
            return self._answer(problem, "start_invalid", why, names[0], began)
        best: FootPlan | None = None
        for k, name in enumerate(names):
            last = k == len(names) - 1
            until = end if last or end == NEVER else min(began + int(f.share * limit * 1e9), end)
            found = self._search(problem, world, name, (began, until, end, most))
            if best is None or _better(found, best):
                best = found
            if best.share >= f.enough:
                break
        assert best is not None
        return replace(best, planning_time_s=(time.clock_gettime_ns(CLOCK) - began) * 1e-9)

    def signature(self, before: ArrayLike, after: ArrayLike, spacing: float) -> int:
        """Of the transition from feet (4, 3) to feet (4, 3): which ones move, from where to where."""
        places = np.concatenate([keys_of(before, spacing), keys_of(after, spacing)])
        moved = (
            np.abs(np.asarray(before, dtype=np.float64) - np.asarray(after, dtype=np.float64)).max(axis=1) > _SAME[0]
        )
        rows = np.arange(4, dtype=np.int32)
        return int(move_signature(places, rows, np.where(moved, rows + 4, rows).astype(np.int32)))

    def warm_up(self) -> None:
        """Compile, or load, what the searches call."""
        feet = self.robot.stance + np.array([0.0, 0.0, -self.robot.stance[0, 2]])
        flat = np.zeros((0, 3))
        none = Candidates(flat, flat, np.zeros(0), *(np.zeros(0, np.int64),) * 2, np.zeros(0, np.bool_))
        nothing = Outlines(np.zeros((0, 4, 4)), np.zeros((0, 2)), np.zeros(1, np.int64))
        surface = surface_of(
            nothing, np.zeros(0, np.bool_), middle=(0, 0), radius=0.5, cell=0.02, seam=0.0, trunk_width=0.2
        )
        up = np.tile([0.0, 0.0, 1.0], (4, 1))
        self.plan(FootProblem(none, surface, feet, up, np.array([1.0, 0.0, 0.5])))

    def _world(self, problem: FootProblem) -> World:
        """The candidates and the feet as they stand, with their prices."""
        w = self.settings.walkability
        feet = finite("foothold search: feet", problem.feet, (4, 3), PlannerError)
        finite("foothold search: waypoint", problem.waypoint, (3,), PlannerError)
        c = problem.candidates
        if len(c) + 4 > MOST:
            raise PlannerError(f"foothold search: {len(c)} candidates, expected {MOST - 4} or fewer; thin them first")
        if not (np.isfinite(c.points).all() and np.isfinite(c.normals).all()):
            raise PlannerError("foothold search: a candidate holds a value that is not finite")
        wanted = max(w.wanted_margin, 1e-9)
        price = w.margin_m * np.maximum(1.0 - c.margins / wanted, 0.0) ** 2 + w.assumed_m * c.assumed
        if problem.last is not None and len(problem.last):
            price = price + w.anew_m * kernels.far_from_all(c.points, problem.last, *_SAME)
        every = c.with_feet(feet, problem.normals, self.settings.candidates.spacing)
        return World(
            np.ascontiguousarray(every.points), np.concatenate([price, np.zeros(4)]), every.keys,
            problem.surface.ground, problem.surface.trunk, np.sort(np.array(list(problem.refused), dtype=np.int64)),
        )  # fmt: skip

    def _start_fault(self, problem: FootProblem) -> str:
        """Why the robot cannot stand as it is said to; empty if it can."""
        s, shape = scratch(), np.empty(SHAPE)
        s.feet[:] = problem.feet
        if not shape_of(s.feet, self.rules.hips, shape):
            return "the feet at the start span no plane"
        if not self.rules.inverse_kinematics:
            return ""
        s.feet[:, 2] += self.body.radius
        level_pose(s.feet, s.weights, self.body.height, TILT, s.pose)
        nominal = s.pose.copy()
        for leg, name in enumerate(LEGS):
            alone = np.arange(4) == leg
            s.pose[:] = nominal
            if not legs_fit(self.body, alone, s):
                return f"inverse kinematics: {name} at {np.round(problem.feet[leg], 3).tolist()} m is out of reach"
        return ""

    def _search(self, problem: FootProblem, world: World, name: str, times: tuple[int, int, int, int]) -> FootPlan:
        """The best path of one gait until its first one's deadline, made better until the last one."""
        began, until, end, most = times
        f, best, first = self.settings.feet, None, 0.0
        gait, phase = gait_table(name), next_phase(name, problem.swung)
        for weight in f.weights:
            limit = until if best is None else end
            now = time.clock_gettime_ns(CLOCK)
            if best is not None and end != NEVER and now + _WORTH * (end - began) > end:
                break
            tolerance = f.tolerance if problem.tolerance is None else problem.tolerance
            within = f.yaw_tolerance if problem.yaw_tolerance is None else problem.yaw_tolerance
            task = Task(
                np.asarray(problem.waypoint, dtype=np.float64), tolerance,
                math.nan if problem.yaw is None else float(problem.yaw), within, phase, weight, f.progress,
                limit, most,
            )  # fmt: skip
            self._number += 1
            why, count, last = kernels.search(
                world, self.body, self.rules, gait, task, problem.field or no_field(), self._memory, self._number
            )
            if best is None:
                first = (time.clock_gettime_ns(CLOCK) - began) * 1e-9
            status: Status = "found" if why == FOUND else ("partial" if count > 1 else "exhausted")
            cost = float(self._memory.cost[last])
            left, whole = float(self._memory.left[last]), float(self._memory.left[0])
            share = 1.0 if why == FOUND else (1.0 - left / whole if whole > 0 and count > 1 else 0.0)
            if best is None or (status == "found" and cost < best.cost - 1e-9):
                reason = "" if why == FOUND else self._reason(why, len(problem.candidates))
                best = self._answer(problem, status, reason, name, began, world, count, (weight, cost, first, share))
            if why != FOUND:
                break
        assert best is not None
        return best

    def _reason(self, why: int, candidates: int) -> str:
        """What stopped a search: that there is nowhere to go, its time, or the rule that refused most."""
        if not candidates:
            return "no region near the robot holds a foothold"
        tally = self._memory.tally
        worst = int(np.argmax(tally))
        most = f"most was refused by: {RULES[worst]}" if tally[worst] else "no foothold near the feet"
        if why == OUT_OF_TIME:
            return f"{_LATE}; {most}"
        return f"the queue's memory was full; {most}" if why == kernels.OUT_OF_MEMORY else f"nothing leads on; {most}"

    def _answer(
        self, problem: FootProblem, status: Status, reason: str, gait: str, began: int, world: World | None = None,
        count: int = 0, how: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    ) -> FootPlan:  # fmt: skip
        m, n = self._memory, len(problem.candidates)
        path = m.path[:count].copy() if count else np.zeros(0, np.int32)
        stances = m.feet[path] if count else np.arange(n, n + 4, dtype=np.int32)[None]
        points = np.concatenate([problem.candidates.points, problem.feet])
        normals = np.concatenate([problem.candidates.normals, problem.normals])
        keys = np.zeros(n + 4, np.int64) if world is None else world.place
        return FootPlan(
            status, reason, gait, (next_phase(gait, problem.swung) + np.arange(len(stances))) % len(GAITS[gait]),
            stances, points[stances], normals[stances], keys[stances], stances[1:] == stances[:-1],
            m.pose[path] if count else np.zeros((1, 6)), how[1], how[3], reason.startswith(_LATE),
            int(m.counts[N_EXPANDED]) if count else 0,
            int(m.counts[N_VALIDATED]) if count else 0, how[0], how[2], (time.clock_gettime_ns(CLOCK) - began) * 1e-9,
        )  # fmt: skip


def gait_table(name: str) -> Gait:
    """A gait of :data:`.GAITS` for compiled code.

    Raises:
        PlannerError: a name that is not there.
    """
    if name not in GAITS:
        raise PlannerError(f"foothold search: gait {name!r}, expected one of {', '.join(GAITS)}")
    phases = GAITS[name]
    legs = np.full((len(phases), max(map(len, phases)), 2), -1, np.int64)
    for p, sets in enumerate(phases):
        for k, swings in enumerate(sets):
            legs[p, k, : len(swings)] = swings
    return Gait(legs, np.array([len(sets) for sets in phases]))


def next_phase(name: str, swung: Sequence[int] | None) -> int:
    """The phase that follows after legs have swung; 0 at the begin."""
    phases = GAITS[name]
    for p, sets in enumerate(phases):
        if swung and any(set(swung) & set(swings) for swings in sets):
            return (p + 1) % len(phases)
    return 0


def _better(a: FootPlan, b: FootPlan) -> bool:
    """Whether a gait's answer is worth more than an earlier gait's: it comes farther, by more than a little."""
    return a.share > b.share + 0.1
