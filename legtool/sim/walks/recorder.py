"""The recorder: what the robot measured, was told and did, row by row."""

from __future__ import annotations

import numpy as np

from legtool.sim.walks.environment import Answer, Observation, VelocityCommand
from legtool.sim.walks.simulated import SimulatedRobot
from legtool.sim.walks.simulation import WalkLog

#: Ticks between the rows of a suite's recordings.
EVERY = 2
#: In the place of a velocity command where there is none.
_NO_COMMAND = np.zeros(3)


class Recorder:
    """Keeps rows for a recording; a :class:`.Subscriber`.

    Attributes:
        log: the rows.
    """

    def __init__(self, environment: SimulatedRobot, *, ticks: int, every: int = EVERY) -> None:
        self.log = WalkLog(ticks=ticks, every=every)
        self._simulation = environment.simulation

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """A row when it is time."""
        if (self._simulation.tick - 1) % self.log.every == 0:
            command = answer.values if isinstance(answer, VelocityCommand) else _NO_COMMAND
            self.log.add(observation.state.values, command, self._simulation.torque)

    def end(self) -> None:
        """Nothing to close."""
