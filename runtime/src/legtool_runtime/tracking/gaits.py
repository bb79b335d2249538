"""Gaits: in which order and for how long feet swing, and the contact plans they make."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.errors import TrackingError
from legtool_runtime.robot import LEGS, TROT_PAIRS, Robot
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance

#: Legs that swing together, in order: a trot, and the crawl RL, FL, RR, FR.
TROT = TROT_PAIRS
CRAWL = ((2,), (0,), (3,), (1,))
#: Share of the cycle in stance of a trot whose footholds are chosen on the way.
_DUTY = 0.54


@dataclass(frozen=True)
class GaitTiming:
    """How a gait runs.

    Attributes:
        groups: legs that swing together, in order; each leg once.
        swing_s: duration of a swing.
        full_stance_s: with all feet on the ground, between two swings.
    """

    groups: tuple[tuple[int, ...], ...] = TROT
    swing_s: float = 0.40
    full_stance_s: float = 0.08

    def __post_init__(self) -> None:
        if sorted(leg for group in self.groups for leg in group) != [0, 1, 2, 3]:
            raise TrackingError(f"gait: groups {self.groups}, expected each leg 0 to 3 once")
        for name, low in (("swing_s", 0.05), ("full_stance_s", 0.0)):
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and low <= value <= 10.0):
                raise TrackingError(f"gait: {name} is {value!r}, expected {low:g} to 10 s")

    @property
    def step_s(self) -> float:
        """From one lift-off to the next group's [s]."""
        return self.swing_s + self.full_stance_s

    @property
    def cycle_s(self) -> float:
        """From one lift-off of a leg to its next [s]."""
        return len(self.groups) * self.step_s

    @property
    def stance_s(self) -> float:
        """How long a foot stands [s]."""
        return self.cycle_s - self.swing_s

    @classmethod
    def trot(cls) -> GaitTiming:
        """The trot for planned footholds: swings of 0.40 s, full stance of 0.08 s."""
        return cls()

    @classmethod
    def crawl(cls) -> GaitTiming:
        """The crawl for planned footholds: swings of 0.60 s, full stance of 0.15 s."""
        return cls(CRAWL, 0.60, 0.15)

    def slower(self, by: float) -> GaitTiming:
        """The same gait with all durations times a factor."""
        return replace(self, swing_s=by * self.swing_s, full_stance_s=by * self.full_stance_s)

    @classmethod
    def trot_at(cls, speed: float) -> GaitTiming:
        """The trot whose footholds are chosen on the way: 1.2 + v cycles per second, 54 % of each in stance.

        Args:
            speed: commanded [m/s]; faster than 1.2 m/s counts as that.

        Raises:
            TrackingError: a speed that is not a finite number.
        """
        if not math.isfinite(speed):
            raise TrackingError(f"gait: a speed of {speed} m/s, expected a finite number")
        frequency = 1.2 + min(abs(speed), 1.2)
        swing = (1.0 - _DUTY) / frequency
        return cls(TROT, swing, 0.5 / frequency - swing)

    @classmethod
    def crawl_online(cls) -> GaitTiming:
        """The crawl whose footholds are chosen on the way: swings of 0.35 s, full stance of 0.20 s."""
        return cls(CRAWL, 0.35, 0.20)


def plan_from_gait(
    timing: GaitTiming,
    footholds: Sequence[ArrayLike],
    *,
    start_s: float,
    normals: Sequence[ArrayLike] | None = None,
    movable_m: float = 0.0,
    robot: Robot | None = None,
) -> ContactPlan:
    """A plan over footholds of each leg: the first is where it stands, and it stays on its last.

    Args:
        timing: of the gait.
        footholds: of each leg (k, 3), contact points, world frame [m]; legs may have different numbers of them.
        start_s: lift-off of the first group.
        normals: of each leg (k, 3); None: all point straight up.
        movable_m: how far places may still move, but for those where the robot stands.
        robot: whose legs must reach the places; None leaves that unchecked.

    Raises:
        TrackingError: footholds that are no list of places for each leg, or a plan that is refused.
    """
    if len(footholds) != 4 or (normals is not None and len(normals) != 4):
        raise TrackingError(f"gait: footholds of {len(footholds)} legs, expected {', '.join(LEGS)}")
    rows: list[list[Stance]] = []
    for leg in range(4):
        places = np.asarray(footholds[leg], dtype=np.float64)
        if places.ndim != 2 or places.shape[1] != 3 or not len(places):
            raise TrackingError(f"gait: footholds of {LEGS[leg]} have shape {places.shape}, expected (k, 3), k ≥ 1")
        ups = np.tile([0.0, 0.0, 1.0], (len(places), 1)) if normals is None else np.asarray(normals[leg], np.float64)
        if ups.shape != places.shape:
            raise TrackingError(f"gait: normals of {LEGS[leg]} have shape {ups.shape}, expected {places.shape}")
        group = next(n for n, legs in enumerate(timing.groups) if leg in legs)
        lift = start_s + group * timing.step_s + timing.cycle_s * np.arange(len(places) - 1)
        begins, ends = [-math.inf, *(lift + timing.swing_s)], [*lift, math.inf]
        rows.append(
            [
                Stance(float(begins[k]), float(ends[k]), places[k], ups[k], movable_m if k else 0.0)
                for k in range(len(places))
            ]
        )
    return ContactPlan(rows, robot=robot)


def walked_on(
    plan: ContactPlan,
    timing: GaitTiming,
    place_of: Callable[[int, float], tuple[NDArray[np.float64], NDArray[np.float64]]],
    *,
    start_s: float,
    until_s: float,
    movable_m: float = 0.5,
) -> ContactPlan:
    """A plan carried on by a gait until every leg has a touchdown after ``until_s``: what is to be chosen on the way.

    Args:
        plan: so far; legs whose last stance has no end lift off when the gait says.
        timing: of the gait.
        place_of: place (3,) and normal (3,) of a leg's next stance, by leg and touchdown [s].
        start_s: lift-off of the first group, for legs that have always stood; others stand as long as the gait says.
        until_s: end of the horizon.
        movable_m: how far these places may still move.
    """
    rows = [list(row) for row in plan.stances]
    for leg, row in enumerate(rows):
        group = next(n for n, legs in enumerate(timing.groups) if leg in legs)
        while row[-1].begin_s <= until_s:
            last = row[-1]
            if not math.isfinite(last.end_s):
                stood = last.begin_s + timing.stance_s
                end = stood if math.isfinite(stood) else start_s + group * timing.step_s
                row[-1] = replace(last, end_s=end)
            begin = row[-1].end_s + timing.swing_s
            place, normal = place_of(leg, begin)
            row.append(Stance(begin, math.inf, place, normal, movable_m))
    return ContactPlan(rows)
