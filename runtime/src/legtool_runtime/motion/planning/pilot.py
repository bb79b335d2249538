"""Walks to a goal by a planner's plans, also where none is whole or an obstacle is crossed with a run-up alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.motion.model import MotionState
from legtool_runtime.motion.planning.plan import Goal, Plan
from legtool_runtime.motion.planning.planner import Planner
from legtool_runtime.terrain.costmap import FootCostmap

Array = NDArray[np.float64]

#: Coming this much nearer to the goal is headway [m].
_HEADWAY_M = 0.05
#: A robot without headway for this long need not be told again that it halts at cruise speed [s].
_HESITATION_S = 0.7
#: Backing off ends after this, however far it led [s].
_BACK_OFF_S = 6.0
#: The goal behind lies farther than the run-up, so that the robot walks there instead of creeping up to it [m].
_BEYOND_M = 0.6
#: By this share each further run-up for one place is longer, up to so many times.
_LONGER, _LONGEST = 0.25, 4


class Pilot:
    """Turns a planner's plans into commands, one at each call; one pilot for each walk.

    Where no whole sequence is found, because none is safe or time is up, it goes on with the one that the last step
    began with: to brake before an edge, against that plan, is no surer way over it. A robot that has halted before an
    obstacle backs off for a run-up, if some command goes backwards: what is crossed at speed alone is never crossed
    from rest, and waiting there would be a trap. Until it is past that place it plans boldly (:meth:`.Planner.plan`):
    what keeps margins was seen to lead nowhere there. With a steered goal it never backs off: that is the operator's to
    decide.

    Attributes:
        planner: makes the plans.
        plan: the latest, None before the first.
        backing_off: whether the robot is on its way back for a run-up.
    """

    def __init__(
        self, planner: Planner, *, cruise_speed: float | None = None, patience_s: float = 2.0, run_up_m: float = 0.8
    ) -> None:
        """Begin a walk.

        Args:
            planner: makes the plans.
            cruise_speed: faster commands are kept for when no safe sequence goes on without, and for run-ups until the
                obstacle is left behind [m/s]: at speed, a step that ends late on lower ground leads farther than the
                models know. None: all are for always.
            patience_s: without headway for this long the robot backs off [s].
            run_up_m: by this much [m]; by more at each further attempt to get past one place.
        """
        self.planner = planner
        self.plan: Plan | None = None
        self._cruise_speed, self._patience_s, self._run_up_m = cruise_speed, patience_s, run_up_m
        self._reverses = bool((planner.commands[:, 0] < 0).any())
        #: Least distance to the goal so far [m], when that was [s], and where the goal was then.
        self._least, self._since_s, self._goal = math.inf, 0.0, (math.inf, math.inf)
        self._back: Goal | None = None
        #: Farther from the goal than this the robot is not yet past what it took a run-up for [m].
        self._past = math.inf
        self._attempts = 0
        #: The whole plans that the latest steps began with, and how many steps there had been.
        self._whole: list[tuple[int, Plan]] = []

    @property
    def backing_off(self) -> bool:
        """Whether the robot is on its way back for a run-up."""
        return self._back is not None

    def command(
        self,
        state: MotionState,
        costmap: FootCostmap,
        *,
        position: ArrayLike,
        rotation: ArrayLike,
        goal: Goal,
        time_s: float,
        steps: int,
    ) -> Array:
        """What to command from now on; to be asked for in full stance, as often as one likes.

        Args:
            state: at the planner's instant, just before the step that is planned.
            costmap: where feet may stand.
            position: (3,) CoM, world frame [m].
            rotation: (3, 3) base to world.
            goal: where to walk.
            time_s: now [s].
            steps: steps begun so far, ``StepTracker.steps``.

        Returns:
            (3,) vx, vy [m/s], yaw rate [rad/s].

        Raises:
            StateError, MapError, PlannerError: at the first call, what the planner could not plan from
                (:meth:`.Planner.check`).
        """
        if self.plan is None:
            self.planner.check(state, costmap, position=position, rotation=rotation, goal=goal)
        x, y = (float(value) for value in np.asarray(position, dtype=np.float64)[:2])
        towards, cruising = self._towards(goal, x, y, time_s)
        bold = not self.backing_off and math.hypot(goal.x - x, goal.y - y) > self._past
        plan = self.planner.plan(state, costmap, position=position, rotation=rotation, goal=towards, bold=bold)
        if cruising and (plan.halts or plan.status == "blocked"):
            spent = plan.planning_time_s
            plan = self.planner.plan(state, costmap, position=position, rotation=rotation, goal=goal)
            plan = plan._replace(planning_time_s=spent + plan.planning_time_s)
        self.plan = plan
        if plan.status in ("goal", "horizon"):
            before = [earlier for earlier in self._whole if earlier[0] < steps]
            self._whole = [*before[-1:], (steps, plan)]
            return plan.command
        for made, whole in self._whole:
            if made < steps and steps - made < len(whole.commands):
                command: Array = whole.commands[steps - made]
                return command
        return plan.command

    def _towards(self, goal: Goal, x: float, y: float, time_s: float) -> tuple[Goal, bool]:
        """The goal; or one behind the robot, where there was no headway for a while. Whether at cruise speed."""
        left = math.hypot(goal.x - x, goal.y - y)
        moved = math.hypot(goal.x - self._goal[0], goal.y - self._goal[1]) > self._run_up_m
        if self._back is not None:
            there = math.hypot(self._back.x - x, self._back.y - y) <= _BEYOND_M
            if not (there or moved or time_s - self._since_s > _BACK_OFF_S):
                return self._back, False
            self._back, self._least = None, math.inf
        if moved:
            self._past = math.inf
        if moved or left < self._least - _HEADWAY_M or left <= self.planner.settings.goal_tolerance_m:
            self._least, self._since_s, self._goal = left, time_s, (goal.x, goal.y)
        elif self._reverses and not goal.steered and time_s - self._since_s > self._patience_s:
            # Another run-up for the same place is a longer one, so that its steps fall otherwise.
            self._attempts = min(self._attempts + 1, _LONGEST) if left > self._past else 0
            self._since_s, self._past = time_s, left - self._run_up_m
            away = (self._run_up_m * (1.0 + _LONGER * self._attempts) + _BEYOND_M) / left
            # Backwards, not turned round: the heading is that of the way to the goal.
            heading = math.atan2(goal.y - y, goal.x - x)
            self._back = Goal(x + away * (x - goal.x), y + away * (y - goal.y), heading, goal.max_speed)
            return self._back, False
        cruise, hesitates = self._cruise_speed, time_s - self._since_s > _HESITATION_S
        if cruise is None or hesitates or left > self._past:
            return goal, False
        if goal.max_speed is not None and goal.max_speed <= cruise:
            return goal, False
        return replace(goal, max_speed=cruise), True
