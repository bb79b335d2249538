"""EM-DTC: a learned policy for ANYmal that tracks a planner's footholds (QuadPiPS, [104]).

The public policy was trained on ANYmal D with OCS2's plans. Here a trot's nominal footholds take their place, each
moved to where the planner's selector says: the plan of EM-MPC on the policy's own clock.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.sim.controllers.anymal.heights import along_steps
from legtool.sim.controllers.anymal.senses import (
    ACTION_SCALE,
    COMMAND,
    HOME,
    LEGS,
    RATE,
    RATE_HZ,
    SPEEDS,
    TICKS,
    VELOCITY,
    Drives,
    Senses,
    ask,
    load_network,
)
from legtool.sim.robots.robot import SimRobot
from legtool.sim.robots.state import RobotState
from legtool_runtime.foothold.gait import Gait
from legtool_runtime.rotations import from_angles, yaw_of
from legtool_runtime.tracking.gait_tracker import Guidance
from legtool_runtime.tracking.selectors import Wish, turned

Array = NDArray[np.float64]

INPUTS = 124
#: A trot without full stance: each pair stands for so long, and then swings as long [s].
PHASE_S = 0.35
#: When each leg's stance begins [s]; legs FL, FR, RL, RR.
_BEGINS_S = np.array([0.0, PHASE_S, PHASE_S, 0.0])
#: Feet of ANYmal C below the base: front and hind ahead, and outwards; the base above them [m].
_FRONT_M, _HIND_M, _SIDE_M, HEIGHT_M = 0.41, -0.38, 0.26, 0.53
#: Heights on each foot's way, and the most that they are off the foot [m].
_SAMPLES, _MOST_M = 10, 0.5
_NOMINAL = np.array([[_FRONT_M, _SIDE_M], [_FRONT_M, -_SIDE_M], [_HIND_M, _SIDE_M], [_HIND_M, -_SIDE_M]])


class Plan(NamedTuple):
    """What the policy is told: ``footholds`` (4, 3) at the next switch of stance and swing, world frame [m], legs FL,
    FR, RL, RR; ``stands`` (4,); ``joints`` (12,) then, in the policy's order [rad]; ``left_s`` until then."""

    footholds: Array
    stands: NDArray[np.bool_]
    joints: Array
    left_s: float


class EmDtcController:
    """Walks by the policy; a :class:`.GaitController` that takes of guidance command, selector and map."""

    takes: Literal["guided gaits"] = "guided gaits"

    def __init__(self, robot: SimRobot, network: Path | None) -> None:
        """Take the robot and the policy's file.

        Raises:
            SettingsError: a file that is not the policy, or a robot that is not ANYmal.
        """
        self._robot, self._drives = robot.geometry, Drives(robot)
        self._network = load_network(network, "em_dtc", inputs=INPUTS)
        self._forget()

    def _forget(self) -> None:
        self._tick, self._time_s = 0, 0.0
        self._action, self._target = np.zeros(12), HOME.copy()
        self.plan: Plan | None = None

    def reset(self, state: RobotState) -> None:
        """Forget the past."""
        del state
        self._forget()

    def step(self, state: RobotState, guidance: Guidance) -> Array:
        """Torques at one tick, see :class:`.GaitController`; plan and policy are made anew fifty times a second."""
        if self._tick % TICKS == 0:
            felt = self._drives.feel(state)
            self.plan = self._planned(felt, guidance)
            self._action = ask(self._network, self._observation(felt, self.plan, guidance))
            self._target = HOME + ACTION_SCALE * self._action
            self._time_s += 1.0 / RATE_HZ
        self._tick += 1
        return self._drives.torques(state, self._target)

    def outcome(self) -> str:
        """It goes on for ever."""
        return ""

    def _planned(self, felt: Senses, guidance: Guidance) -> Plan:
        """Footholds of the feet that swing: base at the next switch + nominal + half a stance's way, moved to the place
        that the selector finds."""
        into = math.fmod(self._time_s + 1e-9, PHASE_S)
        left = PHASE_S - into
        stands = np.mod(self._time_s + 1e-9 - _BEGINS_S, 2.0 * PHASE_S) < PHASE_S
        vx, vy, rate = (float(value) for value in guidance.command)
        yaw = float(yaw_of(felt.rotation))
        then = yaw + rate * left
        base = felt.position[:2] + turned((vx * left, vy * left), yaw + 0.5 * rate * left)
        ground = float(felt.soles[stands, 2].mean())
        footholds = felt.soles.copy()
        gait = Gait(min(math.hypot(vx, vy) * 2.0 * PHASE_S, 2.0), 0.5 / PHASE_S, 0.5, left)
        for leg in np.flatnonzero(~stands):
            nominal = base + turned(_NOMINAL[leg] + 0.5 * PHASE_S * np.array([vx, vy]), then)
            hip = np.array([*(base + turned(self._robot.hips[leg][:2], then)), ground + HEIGHT_M])
            wish = Wish(int(leg), nominal, then, hip, (vx, vy, 0.0, 0.0, 0.0, rate), gait, math.inf)
            place = guidance.select(wish)
            footholds[leg] = [*nominal, ground] if place is None else place.point
        return Plan(footholds, stands, self._joints(base, then, footholds), left)

    def _joints(self, base: Array, yaw: float, footholds: Array) -> Array:
        """(12,) joints of a trunk above its footholds, along the plane that they lie in."""
        z, along, across = footholds[:, 2], _FRONT_M - _HIND_M, 2.0 * _SIDE_M
        pitch = math.atan2(0.5 * float(z[2] + z[3] - z[0] - z[1]), along)
        roll = math.atan2(0.5 * float(z[0] + z[2] - z[1] - z[3]), across)
        middle = np.array([*base, float(z.mean()) + HEIGHT_M])
        centres = footholds + np.array([0.0, 0.0, self._robot.foot_radius])
        angles, _ = self._robot.joints((centres - middle) @ from_angles(roll, pitch, yaw))
        return self._drives.of_policy(angles)

    def _observation(self, felt: Senses, plan: Plan, guidance: Guidance) -> Array:
        """(124,) as in training. Footholds and heights take the legs in the order LF, RF, LH, RH, which is ours."""
        way = plan.footholds - felt.soles
        way[:, 2] = 0.0
        way[plan.stands] = 0.0
        stance = np.mod(self._time_s + 1e-9 - _BEGINS_S, 2.0 * PHASE_S)
        phases = (np.pi * stance / PHASE_S)[LEGS]
        lowest = float(felt.soles[:, 2].min())
        ground = along_steps(guidance.elevation, felt.soles, plan.footholds[:, :2], _SAMPLES, lowest)
        heights = np.clip(ground - felt.soles[:, 2:], -_MOST_M, _MOST_M)
        return np.concatenate(
            [
                VELOCITY * felt.velocity, RATE * felt.rate, felt.gravity, COMMAND * guidance.command,
                felt.joints - HOME, SPEEDS * felt.speeds, self._action,
                (way @ felt.rotation)[:, :2].ravel(), plan.joints - HOME,
                plan.stands[LEGS].astype(np.float64), np.full(4, plan.left_s),
                np.cos(phases), np.sin(phases), heights.ravel(),
            ]
        )  # fmt: skip
