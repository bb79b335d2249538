"""The recorder: what the robot measured, was told and did, row by row."""

from __future__ import annotations

from legtool.sim.walks.environment import Answer, Observation
from legtool.sim.walks.simulated import SimulatedRobot
from legtool.sim.walks.simulation import Log

#: Ticks between rows.
EVERY = 2


class Recorder:
    """Keeps rows for a recording; a :class:`.Subscriber`.

    Attributes:
        log: the rows.
    """

    def __init__(self, environment: SimulatedRobot, *, ticks: int) -> None:
        self.log = Log(ticks=ticks, every=EVERY)
        self._simulation = environment.simulation

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """One row on every other tick."""
        if (self._simulation.tick - 1) % EVERY == 0:
            self.log.add(observation.state.values, answer.values, self._simulation.torque)

    def end(self) -> None:
        """Nothing to close."""
