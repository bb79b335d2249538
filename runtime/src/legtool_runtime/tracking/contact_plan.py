"""Which foot stands where and when: the plan that body reference, preview and swings are made from."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime import checks
from legtool_runtime.cache import kernel
from legtool_runtime.errors import TrackingError
from legtool_runtime.robot import LEGS, Robot
from legtool_runtime.tracking.reach import Legs
from legtool_runtime.tracking.stance_check import stance_fault

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Stance:
    """A foot on the ground.

    Attributes:
        begin_s: touchdown; -inf for a foot that has always stood.
        end_s: lift-off; inf for a foot that stays.
        place: (3,) contact point, world frame [m].
        normal: (3,) of the ground there, world frame; made a unit vector.
        movable_m: how far the place may still be moved before touchdown; 0: it is given.
    """

    begin_s: float
    end_s: float
    place: Array
    normal: Array
    movable_m: float = 0.0


#: Attribute of a stance that has passed all checks.
_PASSED = "_passed"


class PlanTable(NamedTuple):
    """A plan for compiled code: ``begin``, ``end`` (4, k), ``place``, ``normal`` (4, k, 3), ``stances`` (4,)."""

    begin: Array
    end: Array
    place: Array
    normal: Array
    stances: NDArray[np.int64]


#: A leg that should have come to stand longer ago than this and is in the air has stood meanwhile [s].
_STOOD_S = 0.05


class ContactPlan:
    """The stances of each leg, in order of time. Never changed: what alters it returns another plan."""

    def __init__(self, stances: Sequence[Sequence[Stance]], *, robot: Robot | None = None) -> None:
        """Check the stances (4 legs in the order of LEGS, each in order of time).

        Args:
            stances: of each leg.
            robot: whose legs must reach the places within their joints' limits, and uncrossed; None leaves that
                unchecked.

        Raises:
            TrackingError: a leg that never stands, values that are not finite, intervals that overlap or are not in
                order, a normal that does not point up, a place that no pose between its neighbours reaches within the
                joints' limits, or one whose foot crosses another.
        """
        if len(stances) != 4:
            raise TrackingError(f"contact plan: stances of {len(stances)} legs, expected {', '.join(LEGS)}")
        self.stances = tuple(
            tuple(_checked(s, f"{LEGS[l]}, stance {k}") for k, s in enumerate(stances[l])) for l in range(4)
        )
        for name, leg in zip(LEGS, self.stances, strict=True):
            if not leg:
                raise TrackingError(f"contact plan: {name} never stands; give each leg one stance or more")
            for k, (before, after) in enumerate(itertools.pairwise(leg)):
                if not before.end_s < after.begin_s:
                    raise TrackingError(
                        f"contact plan: {name}, stance {k} ends at {before.end_s:g} s and stance {k + 1} begins at "
                        f"{after.begin_s:g} s; give stances in order of time, with a swing between two of them"
                    )
        if robot is not None:
            self._refuse_unwalkable(robot)

    def _refuse_unwalkable(self, robot: Robot) -> None:
        legs = Legs.of(robot)
        order = sorted((s.begin_s, leg, k) for leg in range(4) for k, s in enumerate(self.stances[leg]))
        for begin, leg, k in order:
            stance = self.stances[leg][k]
            instant = begin if math.isfinite(begin) else math.nextafter(self.start_s, -math.inf)
            places = np.array([s[self.neighbour(i, instant)].place for i, s in enumerate(self.stances)])
            places[leg] = stance.place
            standing = self.standing(instant)
            standing[leg] = True
            if fault := stance_fault(robot, legs, places, standing, leg):
                raise TrackingError(
                    f"contact plan: {LEGS[leg]}, stance {k} at {np.round(stance.place, 3).tolist()} m {fault}"
                )

    def neighbour(self, leg: int, time_s: float) -> int:
        """The stance that a leg is in, or comes to next; its last one after all."""
        return next((k for k, s in enumerate(self.stances[leg]) if time_s < s.end_s), len(self.stances[leg]) - 1)

    @property
    def start_s(self) -> float:
        """The first event's time; 0 where nothing ever changes."""
        events = self.events()
        return events[0] if events else 0.0

    @property
    def end_s(self) -> float:
        """The last event's time; 0 where nothing ever changes."""
        events = self.events()
        return events[-1] if events else 0.0

    def events(self) -> list[float]:
        """Times of all touchdowns and lift-offs, in order [s]."""
        times = {t for leg in self.stances for s in leg for t in (s.begin_s, s.end_s) if math.isfinite(t)}
        return sorted(times)

    def index(self, leg: int, time_s: float) -> int | None:
        """Which stance a leg is in; None while it swings."""
        for k, stance in enumerate(self.stances[leg]):  # asked many times a tick
            if time_s < stance.end_s:
                return k if stance.begin_s <= time_s else None
        return None

    def standing(self, time_s: float) -> NDArray[np.bool_]:
        """(4,) which legs stand."""
        return np.array([self.index(leg, time_s) is not None for leg in range(4)])

    def current(self, leg: int, time_s: float) -> Stance | None:
        """The stance that a leg is in; None while it swings."""
        k = self.index(leg, time_s)
        return None if k is None else self.stances[leg][k]

    def next(self, leg: int, time_s: float) -> Stance | None:
        """The stance that a leg comes to; None where there is none."""
        return next((s for s in self.stances[leg] if s.begin_s > time_s), None)

    def last(self, leg: int, time_s: float) -> Stance | None:
        """The stance that a leg is in or was in last; None before its first."""
        return next((s for s in reversed(self.stances[leg]) if s.begin_s <= time_s), None)

    def lift_off_s(self, leg: int, time_s: float) -> float:
        """When a standing leg lifts off, or a swinging one did [s]; inf and -inf where it never does."""
        last = self.last(leg, time_s)
        return -math.inf if last is None else last.end_s

    def touchdown_s(self, leg: int, time_s: float) -> float:
        """When a leg touches down next [s]; inf where it never does."""
        following = self.next(leg, time_s)
        return math.inf if following is None else following.begin_s

    def swing_phase(self, leg: int, time_s: float) -> float:
        """How much of its swing is over, 0 to 1; 0 while the leg stands."""
        begin = -math.inf
        for stance in self.stances[leg]:
            if time_s < stance.end_s:
                swings = time_s < stance.begin_s and begin > -math.inf
                return (time_s - begin) / (stance.begin_s - begin) if swings else 0.0
            begin = stance.end_s
        return 0.0

    def delayed(self, by_s: float, *, after_s: float) -> ContactPlan:
        """The plan of a clock that stood still for ``by_s`` at ``after_s``: later events wait, earlier ones stay.

        No leg changes its state: one that stands at ``after_s`` stands on, one that swings swings longer.

        Raises:
            TrackingError: a wait that is negative or not finite.
        """
        if not (math.isfinite(by_s) and by_s >= 0.0):
            raise TrackingError(f"contact plan: a wait of {by_s} s, expected a finite one of 0 s or more")
        later = lambda t: t + by_s if t > after_s else t  # noqa: E731
        return ContactPlan(
            [[replace(s, begin_s=later(s.begin_s), end_s=later(s.end_s)) for s in leg] for leg in self.stances]
        )

    def touched_down(self, leg: int, time_s: float, place: ArrayLike | None = None) -> ContactPlan:
        """The plan after a swinging leg came to stand at ``time_s``, early or late; at ``place`` where it is told.

        A late foot lifts off no earlier than planned; the clock has been stopped for it, or the stance is shorter.
        """
        k = next((k for k, s in enumerate(self.stances[leg]) if time_s < s.end_s), None)
        if k is None or self.stances[leg][k].begin_s == -math.inf or (k and time_s <= self.stances[leg][k - 1].end_s):
            return self
        place = self.stances[leg][k].place if place is None else np.asarray(place, dtype=np.float64)
        return self._replaced(leg, k, begin_s=time_s, place=place, movable_m=0.0)

    def swung_again(self, legs: Sequence[int], time_s: float, by_s: float) -> ContactPlan:
        """The plan after legs in the air have begun another swing to the same places at ``time_s``, ``by_s`` long.

        All else waits for them as in :meth:`delayed`. A leg that has stood there, and lost the ground, comes to stand
        there once more.

        Raises:
            TrackingError: a leg that never swung, or comes to no stance any more.
        """
        coming = [self.neighbour(leg, time_s) for leg in legs]
        if 0 in coming:
            leg = legs[coming.index(0)]
            raise TrackingError(f"contact plan: {LEGS[leg]} has no swing to do again at {time_s:.3f} s")
        begins = [self.stances[leg][k].begin_s for leg, k in zip(legs, coming, strict=True)]
        stood = [begin < time_s - _STOOD_S for begin in begins]
        due = min((begin for begin, past in zip(begins, stood, strict=True) if not past), default=time_s)
        plan = self.delayed(max(time_s - due, 0.0) + by_s, after_s=min(time_s, math.nextafter(due, -math.inf)))
        rows = [list(row) for row in plan.stances]
        for leg, k, past in zip(legs, coming, stood, strict=True):
            there = replace(rows[leg][k], begin_s=time_s + by_s)
            before = rows[leg][k if past else k - 1]
            rows[leg][k if past else k - 1 : k + 1] = [replace(before, end_s=time_s), there]
        return ContactPlan(rows)

    def moved(self, leg: int, k: int, place: ArrayLike, normal: ArrayLike | None = None) -> ContactPlan:
        """The plan with another place for a stance.

        Raises:
            TrackingError: a place farther from the planned one than it may move.
        """
        stance = self.stances[leg][k]
        new = np.asarray(place, dtype=np.float64)
        way = float(np.linalg.norm(new - stance.place))
        if not way <= stance.movable_m + 1e-9:
            raise TrackingError(
                f"contact plan: {LEGS[leg]}, stance {k} moved by {100 * way:.1f} cm, which may move by "
                f"{100 * stance.movable_m:.1f} cm; choose a nearer place, or plan anew"
            )
        up = stance.normal if normal is None else np.asarray(normal, dtype=np.float64)
        return self._replaced(leg, k, place=new, normal=up, movable_m=stance.movable_m - way)

    def since(self, time_s: float) -> ContactPlan:
        """The plan without stances that were over by ``time_s``, but for each leg's last."""
        rows = [[s for s in row[:-1] if s.end_s > time_s] + [row[-1]] for row in self.stances]
        return self if sum(map(len, rows)) == sum(map(len, self.stances)) else ContactPlan(rows)

    def _replaced(self, leg: int, k: int, **changes: object) -> ContactPlan:
        rows = [list(row) for row in self.stances]
        rows[leg][k] = replace(rows[leg][k], **changes)  # type: ignore[arg-type]
        return ContactPlan(rows)

    @cached_property
    def table(self) -> PlanTable:
        """The plan for compiled code."""
        longest = max(len(leg) for leg in self.stances)
        begin, end = np.full((4, longest), np.inf), np.full((4, longest), np.inf)
        place, normal = np.zeros((4, longest, 3)), np.zeros((4, longest, 3))
        for leg, row in enumerate(self.stances):
            for k, stance in enumerate(row):
                begin[leg, k], end[leg, k] = stance.begin_s, stance.end_s
                place[leg, k], normal[leg, k] = stance.place, stance.normal
        return PlanTable(begin, end, place, normal, np.array([len(leg) for leg in self.stances]))


def _checked(stance: Stance, name: str) -> Stance:
    if _PASSED in vars(stance):  # most of a plan's stances are those of the plan that it was made from
        return stance
    told = "; expected three finite numbers"
    place = checks.finite(f"contact plan: {name}: place", stance.place, (3,), TrackingError, advice=told)
    normal = checks.finite(f"contact plan: {name}: normal", stance.normal, (3,), TrackingError, advice=told)
    if max(np.abs(place).max(), np.abs(normal).max()) > checks.FARTHEST_M:
        raise TrackingError(f"contact plan: {name}: place or normal beyond {checks.FARTHEST_M:g} m")
    length = float(np.linalg.norm(normal))
    if not (length > 1e-6 and normal[2] > 0.2 * length):
        raise TrackingError(f"contact plan: {name}: normal {normal.tolist()}, expected one that points up")
    times = checks.numeric(f"contact plan: {name}: begin_s, end_s", [stance.begin_s, stance.end_s], (2,), TrackingError)
    if not times[0] < times[1]:
        raise TrackingError(f"contact plan: {name}: from {times[0]} to {times[1]} s, expected an end after its begin")
    if checks.number(f"contact plan: {name}: movable_m", stance.movable_m, TrackingError, "m") < 0.0:
        raise TrackingError(f"contact plan: {name}: movable by {stance.movable_m} m, expected 0 or more")
    passed = replace(
        stance, begin_s=float(stance.begin_s), end_s=float(stance.end_s), place=place, normal=normal / length
    )
    object.__setattr__(passed, _PASSED, True)
    return passed


@kernel
def stance_at(table: PlanTable, leg: int, time_s: float) -> int:
    """Which stance a leg is in; -1 while it swings."""
    for k in range(table.stances[leg]):
        if time_s < table.end[leg, k]:
            return k if table.begin[leg, k] <= time_s else -1
    return -1


@kernel
def foot_at(table: PlanTable, leg: int, time_s: float, out: Array) -> None:
    """Write the foot's place (3,): where it stands, or on the straight line to where it will, by time."""
    last = table.stances[leg] - 1
    for k in range(last + 1):
        if time_s < table.end[leg, k] or k == last:
            out[:] = table.place[leg, k]
            begin = table.begin[leg, k]
            if time_s < begin and k > 0:
                share = (begin - time_s) / (begin - table.end[leg, k - 1])
                for j in range(3):
                    out[j] += share * (table.place[leg, k - 1, j] - table.place[leg, k, j])
            return
