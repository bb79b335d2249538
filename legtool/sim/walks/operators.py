"""Operators: who commands a velocity without eyes on the feet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.sim.walks.environment import Observation, VelocityCommand
from legtool.sim.walks.guide import Guide
from legtool.sim.worlds.world import World
from legtool_runtime.rotations import rotation_of, yaw_of

Array = NDArray[np.float64]

#: Corrections along a route: yaw rate for an angle [1/s], velocity for a distance [1/s] and at most [m/s].
_TURN_BACK, _WALK_BACK, _MOST_BACK = 1.0, 0.6, 0.1
#: Towards a goal: yaw rate for an angle [1/s]; the robot stops at so much of the goal's radius, or so near where it has
#: none [m].
_TURN, _STOPS_WITHIN, _STOPS_M = 0.25, 0.8, 0.25
#: Of a held heading: yaw rate for an angle [1/s] and for its integral [1/s²], and the most of the latter [rad/s].
_HELD_TURN, _HELD_INTEGRAL, _MOST_AGAINST = 0.5, 0.1, 0.2


class Operator(Protocol):
    """Commands a walk."""

    @property
    def speed(self) -> float:
        """About that is commanded [m/s]."""

    @property
    def heading(self) -> float:
        """Of the robot at the start, off the world's [rad]."""

    def command(self, position: Array, yaw: float) -> tuple[float, float, float]:
        """Forward, left [m/s] and yaw rate [rad/s], in the heading's frame."""


@dataclass(frozen=True, eq=False)
class Route:
    """A straight way at a speed, with a heading along it.

    Attributes:
        start: (3,) x, y [m], yaw [rad] of the way.
        length_m: of the way.
        speed: along it [m/s].
        heading: of the trunk off the way at its start [rad].
        turn: of the trunk over the whole way [rad].
    """

    start: Array
    length_m: float
    speed: float
    heading: float = 0.0
    turn: float = 0.0

    def command(self, position: Array, yaw: float) -> tuple[float, float, float]:
        """What an operator commands: forward, left [m/s] and yaw rate [rad/s], in the heading's frame."""
        c, s = math.cos(self.start[2]), math.sin(self.start[2])
        x, y = float(position[0] - self.start[0]), float(position[1] - self.start[1])
        along, aside = c * x + s * y, c * y - s * x
        share = min(max(along / self.length_m, 0.0), 1.0)
        off = self.start[2] + self.heading + self.turn * share - yaw
        rate = self.turn * self.speed / self.length_m + _TURN_BACK * math.remainder(off, math.tau)
        back = min(max(-_WALK_BACK * aside, -_MOST_BACK), _MOST_BACK)
        angle = self.start[2] - yaw
        c, s = math.cos(angle), math.sin(angle)
        return c * self.speed - s * back, s * self.speed + c * back, rate


class TowardsGoal:
    """The command of QuadPiPS' baselines (section VIII-B): straight to the next place, whatever lies between.

    Attributes:
        speed: of the command [m/s].
        heading: of the robot at the start, off the world's [rad].
    """

    speed, heading = 0.25, 0.0

    def __init__(self, world: World) -> None:
        self._guide = Guide(world)
        self._near_m = _STOPS_WITHIN * world.goal_radius_m if world.goal_radius_m else _STOPS_M

    def command(self, position: Array, yaw: float) -> tuple[float, float, float]:
        """Forward, left [m/s] and yaw rate [rad/s], in the heading's frame."""
        way = self._guide.target(position) - np.asarray(position)[:2]
        far = float(np.hypot(*way))
        if far <= self._near_m:
            return 0.0, 0.0, 0.0
        off = math.remainder(math.atan2(way[1], way[0]) - yaw, math.tau)
        return self.speed * math.cos(off), self.speed * math.sin(off), _TURN * off


class HeldHeading:
    """A command towards a goal for a robot that turns when it is not told to: the angle is integrated, too.

    Attributes:
        speed: of the command [m/s].
        heading: of the robot at the start, off the world's [rad].
    """

    def __init__(self, rule: TowardsGoal) -> None:
        self.speed, self.heading = rule.speed, rule.heading
        self._rule, self._against = rule, 0.0

    def command(self, position: Array, yaw: float) -> tuple[float, float, float]:
        """Forward, left [m/s] and yaw rate [rad/s], in the heading's frame; to be asked for at every tick."""
        vx, vy, rate = self._rule.command(position, yaw)
        off = rate / _TURN
        self._against += _HELD_INTEGRAL * off / CONTROL_RATE_HZ
        self._against = min(max(self._against, -_MOST_AGAINST), _MOST_AGAINST)
        return vx, vy, _HELD_TURN * off + self._against


class OperatedPlanner:
    """Walks by an operator's commands without eyes; for controllers that take velocity commands."""

    def __init__(self, operator: Operator) -> None:
        self._operator = operator

    def act(self, observation: Observation) -> VelocityCommand:
        """The operator's command."""
        state = observation.state
        yaw = float(yaw_of(rotation_of(state.orientation)))
        return VelocityCommand(np.array(self._operator.command(state.position_world, yaw)))
