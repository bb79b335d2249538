"""Plans velocity commands whose footsteps are safe: A* over learned motion models (motion paper, III-B).

At every end of full stance the caller hands in the state, the costmap and the goal, applies the plan's first command
for the coming step, and plans anew. All that can be checked before a walk is checked when the planner is made and by
:meth:`Planner.check`; :meth:`Planner.plan` itself raises for no value it is given.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.errors import LegtoolError, MapError, PlannerError, StateError
from legtool_runtime.motion import search
from legtool_runtime.motion.clock import CLOCK
from legtool_runtime.motion.model import INSTANTS, MotionModel, MotionState
from legtool_runtime.motion.uncertainty import touchdown_variance
from legtool_runtime.robot import LEGS, TROT_PAIRS, Robot
from legtool_runtime.terrain.costmap import FootCostmap

Array = NDArray[np.float64]

#: How a search can end: see :class:`Plan`.
STATUSES = ("goal", "horizon", "deadline", "blocked", "refused")
_MAX_COMMANDS = 4096
_STATUS = {
    search.REACHED_GOAL: "goal",
    search.REACHED_HORIZON: "horizon",
    search.OUT_OF_TIME: "deadline",
    search.OUT_OF_NODES: "deadline",
    search.NOTHING_OPEN: "blocked",
}


def forward_commands(greatest: float = 1.0, step: float = 0.1) -> Array:
    """The paper's action set: (m, 3) forward velocities from 0 by ``step`` [m/s], no sideways motion, no turning."""
    return planar_commands(np.arange(round(greatest / step) + 1) * step, [0.0], [0.0])


def planar_commands(
    forward: ArrayLike = tuple(round(0.1 * i, 1) for i in range(-2, 11)),
    sideways: ArrayLike = (-0.2, 0.0, 0.2),
    turning: ArrayLike = (-0.5, -0.25, 0.0, 0.25, 0.5),
) -> Array:
    """Every combination of vx, vy [m/s] and yaw rate [rad/s]: (m, 3), by default 195 commands."""
    grid = np.meshgrid(*(np.asarray(axis, dtype=np.float64) for axis in (forward, sideways, turning)), indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, 3)


@dataclass(frozen=True)
class PlannerSettings:
    """Settings of the search.

    Attributes:
        horizon: steps to look ahead, N.
        deadline_s: past it the best sequence so far comes back.
        d_max_m: the paper's safety margin: a foothold nearer than this to an unsafe cell costs the difference.
        margin_m: a foothold nearer than this to an unsafe cell is unsafe itself; 0 is the paper's bare check.
        confidence: with this probability each foot is to land on its side of the nearest edge, by the models' predicted
            spread propagated along the horizon, which adds to ``margin_m``. Where that leaves no safe sequence half
            the addition is tried, then none. None leaves the margin fixed as in the paper.
        goal_tolerance_m: the goal is reached within this distance.
        heading_tolerance_rad: and within this angle, if the goal has a heading.
        heading_weight_m_per_rad: cost of a heading that is off, if the goal has one.
        waiting_cost_m: cost of each step of standing in a sequence; 0 is the paper's cost.
        max_velocity_change: greatest change of the planar command from step to step [m/s].
        cell_m: side of the CoM cells in which nodes are duplicates.
        heading_bin_rad: the same for the heading.
        patience_steps: after standing for this many plans in a row nothing is added to ``margin_m`` and the search
            looks three steps further, so that standing in front of an obstacle ends.
    """

    horizon: int = 5
    deadline_s: float = 0.01
    d_max_m: float = 0.06
    margin_m: float = 0.0
    confidence: float | None = 0.8
    goal_tolerance_m: float = 0.1
    heading_tolerance_rad: float = 0.1
    heading_weight_m_per_rad: float = 0.3
    waiting_cost_m: float = 0.1
    max_velocity_change: float = 0.5
    cell_m: float = 0.01
    heading_bin_rad: float = 0.05
    patience_steps: int = 2

    def __post_init__(self) -> None:
        bounds = {
            "horizon": (1, 20),
            "deadline_s": (1e-4, 10.0),
            "d_max_m": (0.0, 1.0),
            "margin_m": (0.0, 0.5),
            "confidence": (0.5, 0.9999),
            "goal_tolerance_m": (0.001, 5.0),
            "heading_tolerance_rad": (0.001, math.pi),
            "heading_weight_m_per_rad": (0.0, 10.0),
            "waiting_cost_m": (0.0, 10.0),
            "max_velocity_change": (0.01, 10.0),
            "cell_m": (0.001, 0.2),
            "heading_bin_rad": (0.01, math.pi),
            "patience_steps": (1, 100),
        }
        for field in fields(self):
            value, (low, high) = getattr(self, field.name), bounds[field.name]
            if field.name == "confidence" and value is None:
                continue
            kind = (int,) if isinstance(low, int) else (int, float)
            if isinstance(value, bool) or not isinstance(value, kind) or not low <= value <= high:
                raise PlannerError(
                    f"planner settings: {field.name} is {value!r}, expected {'a whole number ' * (kind == (int,))}"
                    f"{low:g} to {high:g}"
                )


@dataclass(frozen=True)
class Goal:
    """Where to walk.

    Attributes:
        x, y: where the CoM is to come, world frame [m].
        heading: which way to face there, world frame [rad]; None where any will do.
        max_speed: commands above the slowest one that is at least this fast are left out [m/s].
        steered: whether it comes from a joystick; such a goal moves with the robot and may lie above an obstacle.

    Raises:
        PlannerError: a value that is not finite, or a negative speed.
    """

    x: float
    y: float
    heading: float | None = None
    max_speed: float | None = None
    steered: bool = False

    def __post_init__(self) -> None:
        values = (self.x, self.y, self.heading or 0.0, self.max_speed or 0.0)
        if not all(math.isfinite(value) for value in values):
            raise PlannerError(f"goal: {self} holds a value that is not finite")
        if self.max_speed is not None and self.max_speed < 0:
            raise PlannerError(f"goal: max_speed is {self.max_speed} m/s, expected at least 0")

    @classmethod
    def from_joystick(
        cls, velocity: ArrayLike, *, position: ArrayLike, heading: float, lookahead_s: float = 4.0
    ) -> Goal:
        """The goal that a velocity leads to; renew it for each plan.

        Args:
            velocity: (3,) vx, vy [m/s] and yaw rate [rad/s] wished for, base frame.
            position: (2 or 3,) CoM now, world frame [m].
            heading: of the robot now [rad].
            lookahead_s: how far ahead the velocity is followed; longer than the horizon's steps take.
        """
        vx, vy, rate = (float(v) for v in np.asarray(velocity, dtype=np.float64))
        x, y = np.asarray(position, dtype=np.float64)[:2]
        turn = rate * lookahead_s
        # The arc of a constant velocity in the turning base frame: ∫ R(rate·t) dt = t·[[a, -b], [b, a]].
        a = math.sin(turn) / turn if abs(turn) > 1e-9 else 1.0
        b = (1.0 - math.cos(turn)) / turn if abs(turn) > 1e-9 else 0.0
        dx, dy = lookahead_s * (a * vx - b * vy), lookahead_s * (b * vx + a * vy)
        c, s = math.cos(heading), math.sin(heading)
        speed = math.hypot(vx, vy)
        return cls(float(x + c * dx - s * dy), float(y + s * dx + c * dy), heading + turn, speed, steered=True)


class Plan(NamedTuple):
    """A sequence of n commands, and what the models expect of it.

    Attributes:
        status: ``goal``: it reaches the goal; ``horizon``: it has the full number of safe steps; ``deadline``: the search
            was stopped, this is the best so far; ``blocked``: no safe sequence is that long, this is as far as it goes;
            ``refused``: there was nothing to plan from, see ``reason``.
        reason: one line for people, empty if all is well.
        commands: (n, 3) vx, vy [m/s], yaw rate [rad/s]; n may be 0.
        cost: (n,) f = d_goal + d_foot (+ waiting) after each step [m].
        position: (n, 3) CoM after each step, world frame [m].
        heading: (n,) after each step, world frame [rad].
        velocity: (n, 3) CoM velocity after each step, base frame [m/s], [rad/s].
        touchdowns: (n, 2, 3) of the front and the hind foot that swing, world frame [m].
        legs: (n, 2) which legs those are.
        clearance: (n, 2) distance of the touchdowns to the nearest unsafe cell [m].
        margins: (n, 2) what it had to be at least [m].
        blocked_leg: if blocked, the leg whose touchdown forbade the most commands where the search got stuck.
        confidence: with which the margins were set: lower than the setting's where that left no safe sequence.
        expanded, generated: nodes of the search.
        planning_time_s: of the whole call.
    """

    status: str
    reason: str
    commands: Array
    cost: Array
    position: Array
    heading: Array
    velocity: Array
    touchdowns: Array
    legs: NDArray[np.int64]
    clearance: Array
    margins: Array
    blocked_leg: str | None
    confidence: float | None
    expanded: int
    generated: int
    planning_time_s: float

    @property
    def command(self) -> Array:
        """(3,) what to command now: the first of the sequence, zero if there is none."""
        return self.commands[0] if len(self.commands) else np.zeros(3)

    @property
    def waits(self) -> bool:
        """Whether the first command is to stand."""
        return not self.command.any()


class Planner:
    """Plans with one robot's motion models. One thread at a time: the search's memory is allocated once."""

    def __init__(
        self,
        model: MotionModel,
        robot: Robot,
        *,
        commands: ArrayLike | None = None,
        settings: PlannerSettings | None = None,
        instant: str = "full_stance_end",
    ) -> None:
        """Prepare the search.

        Args:
            model: ``bundle.motion``.
            robot: ``bundle.robot``.
            commands: (m, 3) vx, vy [m/s], yaw rate [rad/s] to choose from; the paper's by default.
            settings: of the search.
            instant: the moment at which the states to come are taken, one of INSTANTS.

        Raises:
            StateError: the models were learned from states of another instant.
            PlannerError: commands that are not finite, doubled, too many, or without the zero command.
        """
        if instant not in INSTANTS:
            raise StateError(f"instant is {instant!r}, expected {' or '.join(INSTANTS)}")
        if instant != model.instant:
            raise StateError(
                f"states are taken at {instant}, but these motion models were learned from states at {model.instant}; "
                "take the states there, or train on a dataset of the other instant"
            )
        self.settings = settings or PlannerSettings()
        self.model = model
        self.commands = _checked_commands(forward_commands() if commands is None else commands)
        self._speeds = np.hypot(self.commands[:, 0], self.commands[:, 1])
        s = self.settings
        self._longest = s.horizon + _FURTHER
        self._spread, self._noise = touchdown_variance(model, robot.stance, horizon=self._longest)
        self._workspace = search.make_workspace(len(self.commands), self._longest)
        widest = 0.0 if s.confidence is None else _NORMAL.inv_cdf(s.confidence)
        self._quantiles = (widest, 0.5 * widest, 0.0) if widest > 0.0 else (0.0,)
        self._number = 0
        self._waited = 0

    @property
    def foothold_std(self) -> Array:
        """(horizon, 2) standard deviation of the front and hind touchdown of each step ahead, where it is greatest."""
        return np.sqrt(self._spread[: self.settings.horizon])

    def reset(self) -> None:
        """Forget for how long the robot has been standing, before another walk."""
        self._waited = 0

    def check(
        self, state: MotionState, costmap: FootCostmap, *, position: ArrayLike, rotation: ArrayLike, goal: Goal
    ) -> None:
        """Raise at the start of a walk what :meth:`plan` could not plan from.

        Raises:
            StateError: a position or rotation that is not finite, or no rotation.
            MapError: the map does not hold the robot, or is unknown throughout.
            PlannerError: the goal lies inside an obstacle.
        """
        at = self._check_inputs(costmap, position, rotation)[0]
        if not goal.steered:
            if costmap.contains((goal.x, goal.y)) and not costmap.distance_at([(goal.x, goal.y)])[0]:
                cell = np.floor((np.array([goal.x, goal.y]) - costmap.lower_corner) / costmap.resolution_m).astype(int)
                if costmap.known[cell[0], cell[1]]:
                    raise PlannerError(f"goal ({goal.x:.2f}, {goal.y:.2f}) m lies inside an obstacle; move it")
            if math.hypot(goal.x - at[0], goal.y - at[1]) > 100.0:
                raise PlannerError(f"goal ({goal.x:.2f}, {goal.y:.2f}) m is more than 100 m away; are these metres?")

    def plan(
        self, state: MotionState, costmap: FootCostmap, *, position: ArrayLike, rotation: ArrayLike, goal: Goal
    ) -> Plan:
        """Search the best sequence of commands from here.

        Args:
            state: at the planner's instant, just before the step that is planned.
            costmap: where feet may stand.
            position: (3,) CoM, world frame [m].
            rotation: (3, 3) base to world.
            goal: where to walk.

        Returns:
            The plan; where nothing could be planned it has no commands, and says why.
        """
        start = time.clock_gettime_ns(CLOCK)
        try:
            at, turned = self._check_inputs(costmap, position, rotation)
        except LegtoolError as error:
            return self._refused(str(error), start)
        deadline = start + int(self.settings.deadline_s * 1e9)
        impatient = self._waited >= self.settings.patience_steps
        for quantile in self._quantiles[-1:] if impatient else self._quantiles:
            horizon = self._longest if impatient else self.settings.horizon
            plan = self._search(state, costmap, at, turned, goal, quantile, horizon, start, deadline)
            if plan.status != "blocked":
                break
        self._waited = self._waited + 1 if plan.waits and plan.status != "goal" else 0
        return plan

    def _search(
        self,
        state: MotionState,
        costmap: FootCostmap,
        position: Array,
        rotation: Array,
        goal: Goal,
        quantile: float,
        horizon: int,
        start: int,
        deadline: int,
    ) -> Plan:
        s, w = self.settings, self._workspace
        corner = costmap.lower_corner
        terrain = search.Terrain(
            costmap.distance, float(corner[0]), float(corner[1]), 1.0 / costmap.resolution_m,
            0.0 if costmap.unknown_unsafe else math.inf,
        )  # fmt: skip
        limit = math.inf
        if goal.max_speed is not None:
            fast_enough = self._speeds[self._speeds >= goal.max_speed - 1e-9]
            limit = float(fast_enough.min()) + 1e-9 if len(fast_enough) else math.inf
        task = search.Task(
            float(goal.x), float(goal.y), math.nan if goal.heading is None else float(goal.heading),
            s.goal_tolerance_m, s.heading_tolerance_rad, s.heading_weight_m_per_rad, s.d_max_m, s.margin_m,
            quantile, s.waiting_cost_m, s.max_velocity_change, limit, s.cell_m,
            s.heading_bin_rad,
        )  # fmt: skip
        self._number += 1
        weights, covariance, _ = self.model.packed
        why, last, expanded, generated = search.search(
            weights, covariance, self._spread, self._noise, self.commands, self._speeds, rotation, position,
            state.features, state.swing_pair, terrain, task, horizon, deadline, self._number, w,
        )  # fmt: skip
        nodes = []
        while last > 0:
            nodes.append(last)
            last = int(w.parent[last])
        path = np.array(nodes[::-1], dtype=np.int64)
        n = len(path)
        legs = _LEGS_OF_STEPS[state.swing_pair][:n]
        status = _STATUS[why]
        blocked = self._blocked_leg(n) if status == "blocked" else None
        return Plan(
            status=status,
            reason=_reason(why, n, horizon, blocked, s),
            commands=self.commands[w.command[path]],
            cost=w.cost[path],
            position=w.position[path],
            heading=w.yaw[path] + math.atan2(rotation[1, 0], rotation[0, 0]),
            velocity=w.velocity[path],
            touchdowns=w.feet[path[:, None], legs],
            legs=legs,
            clearance=w.clearance[path],
            margins=w.margins[path],
            blocked_leg=blocked,
            confidence=None if s.confidence is None else _NORMAL.cdf(quantile),
            expanded=expanded,
            generated=generated,
            planning_time_s=(time.clock_gettime_ns(CLOCK) - start) * 1e-9,
        )

    def _blocked_leg(self, depth: int) -> str | None:
        rejected = self._workspace.rejected[depth]
        return LEGS[int(rejected.argmax())] if rejected.any() else None

    def _refused(self, reason: str, start: int) -> Plan:
        none = np.zeros((0, 3))
        return Plan(
            "refused", reason, none, none[:, 0], none, none[:, 0], none, np.zeros((0, 2, 3)), _LEGS_OF_STEPS[0][:0],
            none[:, :2], none[:, :2], None, None, 0, 0, (time.clock_gettime_ns(CLOCK) - start) * 1e-9,
        )  # fmt: skip

    def _check_inputs(self, costmap: FootCostmap, position: ArrayLike, rotation: ArrayLike) -> tuple[Array, Array]:
        at, turned = _numbers("position", position, (3,)), _numbers("rotation", rotation, (3, 3))
        if np.abs(turned @ turned.T - _IDENTITY).max() > 1e-3:
            raise StateError("state: rotation is no rotation matrix (base to world)")
        if not costmap.contains(at):
            raise MapError(f"map: the robot at ({at[0]:.2f}, {at[1]:.2f}) m is not on it; are both in one world frame?")
        if not costmap.known.any():
            raise MapError("map: no cell of it has been seen; wait for the first depth image before walking")
        return at, turned

    def warm_up(self) -> None:
        """Compile the search or load it from the user's cache, and touch its memory, so that the first plan is fast."""
        feet = np.zeros((4, 3))
        distance = np.full((3, 3), np.inf, np.float32)
        costmap = FootCostmap(distance, np.ones((3, 3), np.bool_), 1.0, np.full(2, -1.5), False)
        for pair in range(len(TROT_PAIRS)):
            state = MotionState(np.zeros(3), np.zeros(3), np.zeros(3), feet, pair)
            for _ in range(_WARM_CALLS):
                self.plan(state, costmap, position=np.zeros(3), rotation=np.eye(3), goal=Goal(1.0, 0.0))
        self.reset()


_NORMAL = NormalDist()
_FURTHER = 3  # steps that a relaxed search looks beyond the horizon
_WARM_CALLS = 5
_IDENTITY = np.eye(3)
_LEGS_OF_STEPS = tuple(np.array([TROT_PAIRS[(pair + step) % 2] for step in range(32)]) for pair in (0, 1))


def _reason(why: int, steps: int, horizon: int, blocked: str | None, settings: PlannerSettings) -> str:
    if why == search.OUT_OF_TIME:
        return f"the deadline of {settings.deadline_s * 1e3:g} ms came first; best of {steps} of {horizon} steps so far"
    if why == search.OUT_OF_NODES:
        return f"the search's memory of {search.NODES} nodes is full; best of {steps} of {horizon} steps so far"
    if why == search.NOTHING_OPEN:
        leg = f"; {blocked} finds no safe foothold" if blocked else ""
        return f"no safe sequence beyond {steps} of {horizon} steps{leg}"
    return ""


def _numbers(name: str, value: ArrayLike, shape: Sequence[int]) -> Array:
    try:
        array = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise StateError(f"state: {name} is not numbers ({error})") from error
    if array.shape != tuple(shape):
        raise StateError(f"state: {name} has shape {array.shape}, expected {tuple(shape)}")
    if not np.isfinite(array).all():
        raise StateError(f"state: {name} holds a value that is not finite; check the estimator that gave it")
    return array


def _checked_commands(commands: ArrayLike) -> Array:
    try:
        array = np.array(commands, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise PlannerError(f"commands: not numbers ({error})") from error
    if array.ndim != 2 or array.shape[1] != 3 or not 1 <= len(array) <= _MAX_COMMANDS:
        raise PlannerError(f"commands: shape {array.shape}, expected (m, 3) with 1 to {_MAX_COMMANDS} commands")
    if not np.isfinite(array).all():
        raise PlannerError("commands: a value is not finite")
    if len(np.unique(array, axis=0)) != len(array):
        raise PlannerError("commands: some are given twice")
    if array.any(axis=1).all():
        raise PlannerError("commands: the zero command is missing; without it the robot cannot stand")
    return array + 0.0  # no negative zeros
