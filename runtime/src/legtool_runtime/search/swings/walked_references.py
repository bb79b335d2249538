"""Body references of optimised motions, in the form that the tracking controller takes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.rotations import angles_of
from legtool_runtime.search.swings.optimiser import SwingMotion, SwingOptimiser, SwingState
from legtool_runtime.search.swings.settings import SwingSettings
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.body_reference import BodyReference, ReferenceMaker
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.model import TrackedRobot

Array = NDArray[np.float64]

#: Beyond the end of a motion its difference from the controller's own reference fades within this [s].
_FADE_S = 0.2
#: What is kept of motions that are over, for the spline's control points before now [s].
_KEEP_S = 0.6
#: A motion is made anew where no more than this is left of it [s], and after a refusal so long later.
_LEFT_S, _RETRY_S = 0.6, 0.1


class Refusal(NamedTuple):
    """A transition ahead that no motion was found for: the ``rule`` that it breaks, and the feet (4, 3) ``before`` and
    ``after`` it, contact points, world frame [m]."""

    rule: str
    before: Array
    after: Array


class OptimisedReferences(ReferenceMaker):
    """Makes body references of a contact plan from optimised motions, the controller's own where one is refused.

    A motion is optimised when a foot lands elsewhere than planned, when the plan changes, and when little of the last
    one is left, each from the state that the last one comes to then: momentum is kept.

    Attributes:
        optimiser: of motions.
        times_s: wall time of each optimisation.
        refused: rule of each motion that was refused, also over one transition alone.
        refusals: transitions of the plan that are refused and have not begun; for the planner, who takes them out.
        motion: that is followed; None where there is none.
    """

    def __init__(self, robot: TrackedRobot, settings: SwingSettings | None = None) -> None:
        """Take the robot and the settings of the optimisation; None: windows of three transitions."""
        super().__init__(robot.geometry, com_offset=robot.com)
        self.optimiser = SwingOptimiser(robot, settings or SwingSettings(window=3))
        self.times_s: list[float] = []
        self.refused: list[str] = []
        self.refusals: list[Refusal] = []
        self.reset()

    def reset(self) -> None:
        """Forget the past of a walk."""
        self.motion: SwingMotion | None = None
        self.refusals.clear()
        self._landings: tuple[tuple[float, ...], ...] = ()
        self._span_s = (math.inf, -math.inf)
        self._again_s = -math.inf
        #: Times (n,) and centre of mass, roll, pitch, yaw (n, 6) of what was optimised.
        self._times, self._poses = np.empty(0), np.empty((0, 6))

    def from_contacts(
        self,
        plan: ContactPlan,
        *,
        start_s: float,
        horizon_s: float = 2.0,
        poses: Callable[[Array], Array] | None = None,
        elevation: HeightMap | None = None,
    ) -> BodyReference:
        """The reference of the optimised motion, see :meth:`.ReferenceMaker.from_contacts`; with ``poses`` its own."""
        own = super().from_contacts(plan, start_s=start_s, horizon_s=horizon_s, poses=poses, elevation=elevation)
        if poses is not None:
            return own
        self._optimise(plan, own, start_s, elevation)
        if not len(self._times):
            return own
        times = own.start_s + own.step_s * np.arange(len(own.control))
        values = np.array([_pose(own, t) for t in times.tolist()])
        wanted = np.stack([np.interp(times, self._times, self._poses[:, j]) for j in range(6)], axis=1)
        wanted[:, 5] += 2.0 * np.pi * np.round((values[:, 5] - wanted[:, 5]) / (2.0 * np.pi))
        share = np.clip(1.0 - (times - self._times[-1]) / _FADE_S, 0.0, 1.0)
        late = times > self._times[-1]
        if late.any():  # the last difference, carried on
            last = _pose(own, float(self._times[-1]))
            wanted[late] = values[late] + (self._poses[-1] - last)
        offsets = share[:, None] * (wanted - values)
        interpolate(offsets)
        return BodyReference(own.start_s, own.step_s, own.control + offsets)

    def _optimise(self, plan: ContactPlan, own: BodyReference, now_s: float, elevation: HeightMap | None) -> None:
        """A new motion, where there is a reason for one."""
        motion, changed = self.motion, self._changed(plan)
        end_s = -math.inf if motion is None else float(motion.times_s[-1])
        runs_out = end_s - now_s < _LEFT_S and plan.end_s > end_s
        if plan.end_s <= now_s or not (changed or runs_out) or (not changed and now_s < self._again_s):
            return
        start = motion.state(now_s) if motion is not None and now_s < end_s else None
        if start is None and plan.standing(now_s).all():
            point = own.at(now_s)
            start = SwingState(point.position, point.velocity, np.zeros(3), point.rotation)
        rule = ""
        for window in range(self.optimiser.settings.window, 0, -1):  # what lies far ahead may yet change
            found = self.optimiser.optimise(plan, start_s=now_s, start=start, elevation=elevation, window=window)
            self.times_s.append(found.solve_s)
            if found.accepted:
                break
            rule = found.rule
        if rule and (feet := transition_ahead(plan, now_s, window + found.accepted)) is not None:
            self.refusals.append(Refusal(rule, *feet))
        self._span_s, self._landings = (now_s, float(found.times_s[-1])), ()
        self._landings = self._beginning(plan)
        if not found.accepted:
            self.refused.append(found.rule)
            self._again_s = now_s + _RETRY_S
            if changed and len(self._times):  # the last motion steps where the plan does not: it fades from here
                here = [np.interp(now_s, self._times, self._poses[:, j]) for j in range(6)]
                self._keep(now_s, np.array([now_s]), np.array([here]))
                self.motion = None
            return
        self.motion, self._again_s = found, now_s + (_RETRY_S if window < self.optimiser.settings.window else 0.0)
        angles = np.array([angles_of(r) for r in found.rotations])
        places = found.com.copy()  # the tracker takes its height from the trunk's
        places[:, 2] = found.base[:, 2] + found.rotations[:, 2] @ self.com_offset
        self._keep(now_s, found.times_s, np.concatenate([places, angles], axis=1))

    def _keep(self, now_s: float, times: Array, poses: Array) -> None:
        """Follow other poses (n, 6) from now on."""
        kept = (self._times < now_s) & (self._times > now_s - _KEEP_S)
        self._times = np.concatenate([self._times[kept], times])
        self._poses = np.concatenate([self._poses[kept], poses])
        self._poses[:, 5] = np.unwrap(self._poses[:, 5])

    def _changed(self, plan: ContactPlan) -> bool:
        """Whether a foot lands or landed elsewhere, or at another time, than in the last motion."""
        return not self._landings or self._landings != self._beginning(plan)

    def _beginning(self, plan: ContactPlan) -> tuple[tuple[float, ...], ...]:
        """Leg, time and place of the stances that begin in the window of the last motion."""
        first, last = self._span_s
        return tuple(
            (leg, round(s.begin_s, 4), *np.round(s.place, 4).tolist())
            for leg, row in enumerate(plan.stances)
            for s in row
            if first < s.begin_s <= last + 1e-6
        )


def transition_ahead(plan: ContactPlan, time_s: float, number: int) -> tuple[Array, Array] | None:
    """The feet (4, 3) before and after one of the next transitions of a plan, contact points, world frame [m].

    Args:
        plan: that is walked.
        time_s: from when on touchdowns count.
        number: of the transition, from 1 on; its feet touch down at one time.

    Returns:
        None where the plan has no such transition, or its feet have lifted by then.
    """
    landings = sorted({round(s.begin_s, 6) for row in plan.stances for s in row if time_s < s.begin_s < math.inf})
    if number > len(landings):
        return None
    before, after = np.empty((4, 3)), np.empty((4, 3))
    for leg, row in enumerate(plan.stances):
        k = next((k for k, s in enumerate(row) if abs(s.begin_s - landings[number - 1]) < 1e-5), None)
        if k is None:
            last = plan.last(leg, landings[number - 1])
            before[leg] = after[leg] = row[0].place if last is None else last.place
        elif k == 0 or row[k - 1].end_s <= time_s:
            return None
        else:
            before[leg], after[leg] = row[k - 1].place, row[k].place
    return before, after


def _pose(reference: BodyReference, time_s: float) -> Array:
    point = reference.at(time_s)
    return np.concatenate([point.position, point.attitude])


@kernel
def interpolate(values: Array) -> None:
    """Write the control points (n, k) of a cubic B-spline through values (n, k), held at both ends (Thomas 1949)."""
    n, k = values.shape
    upper = np.empty(n)
    for i in range(n):
        side = 1.0 / 6.0
        middle = 4.0 / 6.0 + (side if i in (0, n - 1) else 0.0)
        before = side * upper[i - 1] if i > 0 else 0.0
        pivot = middle - before
        upper[i] = side / pivot
        for j in range(k):
            values[i, j] = (values[i, j] - (side * values[i - 1, j] if i > 0 else 0.0)) / pivot
    for i in range(n - 2, -1, -1):
        for j in range(k):
            values[i, j] -= upper[i] * values[i + 1, j]
