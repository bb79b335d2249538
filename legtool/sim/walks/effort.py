"""What a walk costs: mechanical work of the joints over the way that the trunk went."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.sim.controllers.trot.gait import GRAVITY
from legtool.sim.walks.environment import Answer, Observation
from legtool.sim.walks.simulated import SimulatedRobot

#: The way is the length of the line through the trunk's places so far apart [s]: its sway in each step is no way.
_EVERY_S = 0.5
#: A shorter way says nothing of a cost [m].
_LEAST_M = 0.5


class Effort:
    """Adds up work and way; a :class:`.Subscriber`.

    Attributes:
        work_j: sum of |torque · joint velocity| over joints and ticks: no joint gives back what another one takes.
        way_m: that the trunk went in the horizontal plane.
    """

    def __init__(self, environment: SimulatedRobot) -> None:
        self.work_j = self.way_m = 0.0
        self._simulation = environment.simulation
        robot = self._simulation.robot
        self._dof, self._sign = robot.dof.ravel(), robot.joint_sign.ravel()
        self._weight = robot.mass * GRAVITY
        self._base = robot.base_qpos
        self._every = round(_EVERY_S * CONTROL_RATE_HZ)
        self._ticks = 0

    @property
    def cost_of_transport(self) -> float | None:
        """Work over weight times way, which has no unit; None for a robot that went nowhere."""
        return self.work_j / (self._weight * self.way_m) if self.way_m >= _LEAST_M else None

    def begin(self) -> None:
        """Note where the walk begins."""
        self._last = self._place()

    def tick(self, observation: Observation, answer: Answer) -> None:
        """Add one tick, by the joints' true velocities at its end."""
        del observation, answer
        speeds = self._simulation.data.qvel[self._dof] * self._sign
        self.work_j += float(np.abs(self._simulation.torque * speeds).sum()) / CONTROL_RATE_HZ
        self._ticks += 1
        if self._ticks % self._every == 0:
            self._step()

    def end(self) -> None:
        """Add the last piece of the way."""
        self._step()

    def _step(self) -> None:
        here = self._place()
        self.way_m += float(np.hypot(*(here - self._last)))
        self._last = here

    def _place(self) -> NDArray[np.float64]:
        place: NDArray[np.float64] = self._simulation.data.qpos[self._base : self._base + 2].copy()
        return place
