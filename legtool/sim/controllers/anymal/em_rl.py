"""EM-RL: a learned policy for ANYmal C over a foot clock, which sees heights about its feet (QuadPiPS, [103])."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from legtool.sim.controllers.anymal.heights import around_feet
from legtool.sim.controllers.anymal.senses import (
    ACTION_SCALE,
    COMMAND,
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
from legtool_runtime.rotations import yaw_of
from legtool_runtime.tracking.gait_tracker import Guidance

Array = NDArray[np.float64]

INPUTS = 336
#: The foot clock: period and each leg's lead [s], and how high a foot swings [m]; legs LF, LH, RF, RH.
_PERIOD_S, _LEADS_S, _SWING_M = 0.6, np.array([0.0, 0.3, 0.3, 0.0]), 0.2
#: Where feet stand below their abduction joints, ahead (hind feet behind), outwards and up [m].
_STANCE_M = (0.00790786, 0.05720384, -0.573)
#: ANYmal C's leg, to the FOOT frame: abduction, thigh and shank [m], and the angle between shank and knee's zero [rad].
_D2, _A3, _A4, _KNEE = 0.1972, 0.285, 0.3492, 0.2546
_FRONT, _LEFT = np.array([1.0, -1.0, 1.0, -1.0]), np.array([1.0, 1.0, -1.0, -1.0])
#: The map's heights are seen from so far below the base, and no farther off than this [m].
_BELOW_BASE_M, _FARTHEST_M = 0.5, 1.0


def phases_at(time_s: float) -> Array:
    """(4,) phases of the foot clock [rad], legs LF, LH, RF, RH; a leg swings from 0 to pi."""
    return 2.0 * np.pi * np.modf((time_s + _LEADS_S) / _PERIOD_S)[0]


def clock_joints(time_s: float) -> Array:
    """(12,) joints that the foot clock asks for [rad], legs LF, LH, RF, RH."""
    share = np.minimum(phases_at(time_s) / np.pi, 1.0)
    rise = 1.0 - np.abs(2.0 * share - 1.0)
    up = _SWING_M * rise * rise * (3.0 - 2.0 * rise)
    x, y, z = _FRONT * _STANCE_M[0], _LEFT * _STANCE_M[1], _STANCE_M[2] + up
    below2 = y * y + z * z - _D2 * _D2
    below = np.sqrt(below2)
    hip = np.arctan2(below, _LEFT * _D2) + np.arctan2(z, y)
    bend = np.clip((below2 + x * x - _A3**2 - _A4**2) / (2.0 * _A3 * _A4), -1.0, 1.0)
    knee = -np.arctan2(np.sqrt(1.0 - bend * bend), bend)
    thigh = np.arctan2(-x, below) - _FRONT * np.arctan2(_A4 * np.sin(knee), _A3 + _A4 * np.cos(knee))
    return np.stack([hip, thigh, _FRONT * (knee + _KNEE)], axis=1).ravel()


class EmRlController:
    """Walks by the policy; a :class:`.GaitController` that takes of guidance the command and the map.

    It never stands still: at a zero command it trots in place.
    """

    takes: Literal["guided gaits"] = "guided gaits"

    def __init__(self, robot: SimRobot, network: Path | None) -> None:
        """Take the robot and the policy's file.

        Raises:
            SettingsError: a file that is not the policy, or a robot that is not ANYmal.
        """
        self._drives = Drives(robot)
        self._network = load_network(network, "em_rl", inputs=INPUTS)
        self._forget()

    def _forget(self) -> None:
        self._network.set_hidden_size()  # which also sets the hidden state to zero
        self._tick, self._time_s = 0, 0.0
        self._target = clock_joints(0.0)
        self._residuals, self._speeds, self._actions = (
            deque([np.zeros(12)] * number, maxlen=number) for number in (3, 2, 2)
        )

    def reset(self, state: RobotState) -> None:
        """Forget the past."""
        del state
        self._forget()

    def step(self, state: RobotState, guidance: Guidance) -> Array:
        """Torques at one tick, see :class:`.GaitController`; the policy is asked fifty times a second."""
        if self._tick % TICKS == 0:
            self._think(self._drives.feel(state), guidance)
        self._tick += 1
        return self._drives.torques(state, self._target)

    def outcome(self) -> str:
        """It goes on for ever."""
        return ""

    def _think(self, felt: Senses, guidance: Guidance) -> None:
        residual = felt.joints - clock_joints(self._time_s)
        action = ask(self._network, self._observation(felt, residual, guidance))[:12]
        self._residuals.appendleft(residual)
        self._speeds.appendleft(SPEEDS * felt.speeds)
        self._actions.appendleft(action)
        self._time_s += 1.0 / RATE_HZ
        self._target = clock_joints(self._time_s) + ACTION_SCALE * action

    def _observation(self, felt: Senses, residual: Array, guidance: Guidance) -> Array:
        """(336,) as in training. Histories hold earlier ticks; of three the newest comes first and then the oldest: the
        order of a ring buffer, in training and deployment alike."""
        newest, middle, oldest = self._residuals
        phases = phases_at(self._time_s)
        height = float(felt.position[2])
        ground = around_feet(
            guidance.elevation, felt.soles, float(yaw_of(felt.rotation)), float(felt.soles[:, 2].min())
        )
        seen = np.clip(height - ground[LEGS] - _BELOW_BASE_M, -_FARTHEST_M, _FARTHEST_M)
        return np.concatenate(
            [
                COMMAND * guidance.command, felt.gravity, VELOCITY * felt.velocity, RATE * felt.rate,
                residual, SPEEDS * felt.speeds, newest, oldest, middle, *self._speeds, *self._actions,
                np.cos(phases), np.sin(phases), seen.ravel(),
            ]
        )  # fmt: skip
