"""The recorder: what the robot measured, was told and did, row by row."""

from __future__ import annotations

from legtool.sim.walks.environment import Answer, Observation
from legtool.sim.walks.simulated import SimulatedRobot
from legtool.sim.walks.simulation import Log

#: Ticks between the rows of a suite's recordings.
EVERY = 2


class Recorder:
    """Keeps rows for a recording; a :class:`.Subscriber`.

    Attributes:
        log: the rows.
    """

    def __init__(self, environment: SimulatedRobot, *, ticks: int, every: int = EVERY) -> None:
        self.log = Log(ticks=ticks, every=every)
        self._simulation = environment.simulation

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """A row when it is time."""
        if (self._simulation.tick - 1) % self.log.every == 0:
            self.log.add(observation.state.values, answer.values, self._simulation.torque)

    def end(self) -> None:
        """Nothing to close."""
