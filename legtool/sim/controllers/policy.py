"""A learned policy as a black-box controller: a network is asked, and its actions become joint torques."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from legtool.configs.observation import NetworkSettings
from legtool.configs.policies import JOINT_NAMES, PolicySettings
from legtool.errors import ControllerError, SettingsError
from legtool.sim.controllers.network import Network, load_network
from legtool.sim.controllers.observation import Senses, Shown
from legtool.sim.robots.physics import CONTROL_RATE_HZ
from legtool.sim.robots.state import RobotState
from legtool_runtime.robot import Robot
from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]


class PolicyController:
    """Runs a policy at its own rate and holds its joint targets with a PD law at every control tick.

    The policy is asked at the first control tick that is not before its time. A rate that does not divide that of the
    control loop so is kept on average, with an answer at most one control tick late.
    """

    def __init__(self, settings: PolicySettings, robot: Robot) -> None:
        """Load the networks and check their shapes against the description.

        Args:
            settings: the policy's description.
            robot: the geometry of the robot that it walks.

        Raises:
            SettingsError: a file is missing or no network, its input or output has another size, or the policy runs
                faster than the control loop.
        """
        if settings.rate_hz > CONTROL_RATE_HZ:
            raise SettingsError(
                f"rate_hz {settings.rate_hz:g}: a policy runs at most at the rate of the control loop, "
                f"{CONTROL_RATE_HZ} Hz; expected the rate that it was trained at"
            )
        self._settings = settings
        self._senses = Senses(settings, robot)
        self._asked = _Asked(settings, settings, gives=len(JOINT_NAMES))
        self._estimator = None
        if settings.estimator is not None:
            self._estimator = _Asked(settings.estimator, settings, gives=settings.estimator.outputs)
        order = [JOINT_NAMES.index(name) for name in settings.joint_order]
        self._from_policy = np.argsort(order)
        self._home = np.array(settings.home)
        self._clip, self._scale = settings.per_joint("action_clip"), settings.per_joint("action_scale")
        moving = np.array([name in settings.velocity_targets for name in settings.joint_order])
        self._moving = moving[self._from_policy]
        self._stiffness = np.where(moving, 0.0, settings.per_joint("stiffness"))[self._from_policy]
        self._damping = settings.per_joint("damping")[self._from_policy]
        self._limit = None
        if settings.torque_limit is not None:
            self._limit = settings.per_joint("torque_limit")[self._from_policy]
        self._torque = np.zeros(12)
        self._forget()

    def _forget(self) -> None:
        phase = self._settings.phase
        self._tick = self._answers = 0
        self._raw, self._action = np.zeros(12), np.zeros(12)
        self._phases = np.zeros(0) if phase is None else np.array(phase.start)
        self._target, self._speed = self._home[self._from_policy], np.zeros(12)
        self._senses.elevation = None
        for asked in (self._asked, self._estimator):
            if asked is not None:
                asked.reset()

    def reset(self, state: RobotState) -> None:
        """Forget the past."""
        del state
        self._forget()

    def see(self, elevation: HeightMap | None) -> None:
        """Take what the planner knows of the ground, for the term heights; until then it is level."""
        self._senses.elevation = elevation

    def step(self, state: RobotState, command: Array) -> Array:
        """Run one control tick; the network only when its time has come.

        Raises:
            ControllerError: a network gave something that is not finite.
        """
        if self.accepts_command():
            self._think(state, command)
            self._answers += 1
        self._tick += 1
        error = self._target - state.joint_positions.ravel()
        np.multiply(error, self._stiffness, out=self._torque)
        self._torque -= self._damping * (state.joint_velocities.ravel() - self._speed)
        if self._limit is not None:
            np.clip(self._torque, -self._limit, self._limit, out=self._torque)
        return self._torque

    def accepts_command(self) -> bool:
        """A policy reads its command at every tick of its own."""
        due = self._answers * CONTROL_RATE_HZ / self._settings.rate_hz
        return self._tick >= math.ceil(due - 1e-6)

    def _think(self, state: RobotState, command: Array) -> None:
        settings, senses = self._settings, self._senses
        phase = settings.phase
        if phase is not None and phase.advanced == "before":
            self._advance()
        senses.state, senses.command = state, command
        senses.last_action = self._action if settings.last_action == "filtered" else self._raw
        senses.phases = self._phases
        if phase is not None and phase.idle is not None and not np.any(command):
            senses.phases = np.full(len(self._phases), phase.idle)
        time_s = self._tick / CONTROL_RATE_HZ
        if self._estimator is not None:
            senses.estimate = self._estimator.ask(senses, time_s)
        raw = np.clip(self._asked.ask(senses, time_s), -self._clip, self._clip)
        previous = self._action if settings.filter_previous == "filtered" else self._raw
        self._action = settings.action_filter * raw + (1 - settings.action_filter) * previous
        self._raw = raw
        wanted = (self._scale * self._action)[self._from_policy]
        self._target = self._home[self._from_policy] + np.where(self._moving, 0.0, wanted)
        self._speed = np.where(self._moving, wanted, 0.0)
        if phase is not None and phase.advanced == "after":
            self._advance()

    def _advance(self) -> None:
        assert self._settings.phase is not None
        self._phases = (self._phases + self._settings.phase.frequency_hz / self._settings.rate_hz) % 1.0


class _Asked:
    """A network with what it is shown."""

    def __init__(self, network: NetworkSettings, policy: PolicySettings, *, gives: int) -> None:
        self._file = network.file
        self._shown = Shown(network, policy)
        self._network: Network = load_network(network, shown=self._shown.size, gives=gives, terms=self._shown.terms)

    def reset(self) -> None:
        """Forget the past."""
        self._shown.reset()
        self._network.reset()

    def ask(self, senses: Senses, time_s: float) -> Array:
        """What it answers now.

        Raises:
            ControllerError: that is not finite.
        """
        answer = self._network.ask(self._shown.observe(senses))
        if not np.isfinite(answer).all():
            reason = self._shown.wrong() or "all that it was shown was finite"
            raise ControllerError(
                f"{self._file}: gave NaN or infinity at {time_s:.3f} s, expected finite numbers; {reason}. Look at the "
                "network, and at scales and clips of its observation"
            )
        return answer
