"""What a plan is made of: the commands to choose from, the settings, the goal, and the plan that comes back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.checks import FARTHEST_M, Bounds, within
from legtool_runtime.errors import PlannerError, shown

Array = NDArray[np.float64]

#: How a search can end: see :class:`Plan`.
STATUSES = ("goal", "horizon", "deadline", "blocked", "refused")
#: Reason of a whole plan that halts.
HALTS = "every safe sequence found halts short of the goal"
_MAX_COMMANDS = 4096


def forward_commands(greatest: float = 1.0, step: float = 0.1) -> Array:
    """The paper's action set: (m, 3) forward velocities from 0 by ``step`` [m/s], no sideways motion, no turning."""
    return planar_commands(np.arange(round(greatest / step) + 1) * step, [0.0], [0.0])


def planar_commands(
    forward: ArrayLike = (-0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0),
    sideways: ArrayLike = (-0.2, 0.0, 0.2),
    turning: ArrayLike = (-0.5, -0.25, 0.0, 0.25, 0.5),
) -> Array:
    """Every combination of vx, vy [m/s] and yaw rate [rad/s]: (m, 3), by default 195 commands."""
    grid = np.meshgrid(*(np.asarray(axis, dtype=np.float64) for axis in (forward, sideways, turning)), indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, 3)


#: Steps that a search may look ahead.
MAX_HORIZON = 20
_BOUNDS = {
    "horizon": Bounds(1, MAX_HORIZON),
    "deadline_s": Bounds(1e-4, 10.0),
    "d_max_m": Bounds(0.0, 1.0),
    "margin_m": Bounds(0.0, 0.5),
    "misstep_cost_m": Bounds(0.0, 10.0),
    "goal_tolerance_m": Bounds(0.001, 5.0),
    "heading_tolerance_rad": Bounds(0.001, math.pi),
    "heading_weight_m_per_rad": Bounds(0.0, 10.0),
    "waiting_cost_m": Bounds(0.0, 10.0),
    "max_velocity_change": Bounds(0.01, 10.0),
    "steering_rad_s": Bounds(0.0, 1.0),
    "cell_m": Bounds(0.001, 0.2),
    "heading_bin_rad": Bounds(0.01, math.pi),
}


@dataclass(frozen=True)
class PlannerSettings:
    """Settings of the search. The defaults are those that suites are walked with.

    Attributes:
        horizon: steps to look ahead, N.
        deadline_s: past it the best sequence so far comes back; the clock of the machine then has a part in the plan.
            None for no deadline: the number of nodes that are expanded bounds the search all the same, and the plan is
            a function of the inputs alone, on any machine, however busy.
        d_max_m: the paper's safety margin: a foothold nearer than this to an unsafe cell costs the difference.
        margin_m: a foothold nearer than this to an unsafe cell is a misstep; 0 is the paper's bare check.
        misstep_cost_m: cost of a foothold that is sure to be a misstep; others cost it times the probability that they
            become one, by the models' predicted spread propagated along the horizon. It stays with the sequence, so
            that wide margins are kept where there are any, and narrow ones taken where nothing else leads on: only
            unsafe cells are out of bounds. 0 is the paper's: footholds within ``margin_m`` are out, others are free.
        goal_tolerance_m: the goal is reached within this distance.
        heading_tolerance_rad: and within this angle, if the goal has a heading.
        heading_weight_m_per_rad: cost of a heading that is off: from the goal's or, if it has none and some command
            turns, from the way to the goal. With the paper's commands and goals it has no part.
        waiting_cost_m: cost of each step of standing in a sequence, unless near the goal; 0 is the paper's cost.
        max_velocity_change: greatest change of the planar command from step to step [m/s], as long as that leaves a
            safe first step.
        steering_rad_s: where no command turns: the greatest yaw rate that all moving commands are given, so that the
            robot faces its goal, or as the goal's heading says; 0 is the paper's, a robot that drifts.
        cell_m: side of the CoM cells in which nodes are duplicates.
        heading_bin_rad: the same for the heading.
    """

    horizon: int = 5
    deadline_s: float | None = 0.01
    d_max_m: float = 0.1
    margin_m: float = 0.01
    misstep_cost_m: float = 0.5
    goal_tolerance_m: float = 0.1
    heading_tolerance_rad: float = 0.1
    heading_weight_m_per_rad: float = 0.3
    waiting_cost_m: float = 0.1
    max_velocity_change: float = 0.5
    steering_rad_s: float = 0.1
    cell_m: float = 0.01
    heading_bin_rad: float = 0.05

    def __post_init__(self) -> None:
        bounds = {name: one for name, one in _BOUNDS.items() if name != "deadline_s" or self.deadline_s is not None}
        within("planner settings", self, bounds, PlannerError)


@dataclass(frozen=True)
class Goal:
    """Where to walk.

    Attributes:
        x, y: where the CoM is to come, world frame [m].
        heading: which way to face there, world frame [rad]; None where any will do.
        max_speed: commands above the slowest one that is at least this fast are left out [m/s].
        steered: whether it comes from a joystick; such a goal moves with the robot and may lie above an obstacle.

    Raises:
        PlannerError: a value that is no finite number or beyond all bounds, or a negative speed.
    """

    x: float
    y: float
    heading: float | None = None
    max_speed: float | None = None
    steered: bool = False

    def __post_init__(self) -> None:
        given = {name: getattr(self, name) for name in ("x", "y", "heading", "max_speed")}
        for name, value in given.items():
            if value is None and name in ("heading", "max_speed"):
                continue
            if not Bounds(-FARTHEST_M, FARTHEST_M).hold(value):
                told = shown(value)
                raise PlannerError(f"goal: {name} is {told}, expected a finite number within ±{FARTHEST_M:g}")
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
        status: ``goal``: it reaches the goal; ``horizon``: it has the full number of safe steps (the reason tells if
            all such sequences halt); ``deadline``: the search was stopped, this is the best so far;
            ``blocked``: no safe sequence is that long, this is as far as it goes; ``refused``: there was nothing to
            plan from, see the reason.
        reason: one line for people, empty if all is well.
        commands: (n, 3) vx, vy [m/s], yaw rate [rad/s]; n may be 0.
        cost: (n,) f = d_goal + d_foot (+ waiting, + missteps risked so far) after each step [m].
        position: (n, 3) CoM after each step, world frame [m].
        heading: (n,) after each step, world frame [rad].
        velocity: (n, 3) CoM velocity after each step, base frame [m/s], [rad/s].
        touchdowns: (n, 2, 3) of the front and the hind foot that swing, world frame [m].
        legs: (n, 2) which legs those are.
        clearance: (n, 2) least distance of these feet to an unsafe cell, from landing until they have rolled on [m].
        misstep: (n, 2) probability that they come nearer than ``margin_m``; 0 where missteps cost nothing.
        blocked_leg: if blocked, the leg whose touchdown forbade the most commands where the search got stuck.
        expanded, generated: nodes of the search that found it.
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
    misstep: Array
    blocked_leg: str | None
    expanded: int
    generated: int
    planning_time_s: float

    @property
    def command(self) -> Array:
        """(3,) what to command now: the first of the sequence, zero if there is none."""
        return self.commands[0] if len(self.commands) else np.zeros(3)

    @property
    def halts(self) -> bool:
        """Whether it is whole, but halts short of the goal, as all safe sequences that were found do."""
        return self.status == "horizon" and self.reason == HALTS

    @property
    def waits(self) -> bool:
        """Whether the first command is to stand."""
        return not self.command.any()


def checked_commands(commands: ArrayLike) -> Array:
    """The command set as a (m, 3) array.

    Raises:
        PlannerError: commands that are not finite, doubled, too many, or without the zero command.
    """
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
