"""The recorder: what the robot measured, was told and did, row by row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool.datasets.logs.mcap_writer import PlanColumns
from legtool.sim.controllers.tracked import GuidedController, TrackedController
from legtool.sim.walks.environment import Answer, Observation, VelocityCommand
from legtool.sim.walks.simulated import SimulatedRobot
from legtool.sim.walks.simulation import WalkLog

Array = NDArray[np.float64]

#: Ticks between the rows of a suite's recordings.
EVERY = 2
#: In the place of a velocity command where there is none.
_NO_COMMAND = np.zeros(3)
#: A map is kept so often [s], and what of it lies within this of the trunk to each side [m].
_MAP_S, _MAP_M = 1.0, 1.5


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


class PlanRecorder:
    """Keeps what the tracking controller was to do, at the rows of a :class:`Recorder`; a :class:`.Subscriber`."""

    def __init__(
        self, environment: SimulatedRobot, controller: TrackedController | GuidedController, *, every: int = EVERY
    ) -> None:
        self._simulation, self._controller, self._every = environment.simulation, controller, every
        self._rows: list[tuple[Array, Array, Array]] = []
        self._maps: list[tuple[int, NDArray[np.float32]]] = []
        self._map_due_s = 0.0

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """A row when it is time."""
        tracker = self._controller.tracker
        if (self._simulation.tick - 1) % self._every or tracker is None:
            return
        plan, now = tracker.plan, tracker.clock_s
        stances = [plan.current(leg, now) or plan.next(leg, now) or plan.last(leg, now) for leg in range(4)]
        footholds = np.array([np.full(3, np.nan) if stance is None else stance.place for stance in stances])
        wanted, answered = tracker.wanted, tracker.answer
        body, forces = np.full(7, np.nan), np.full((4, 3), np.nan)
        if wanted is not None and answered is not None:
            body, forces = np.concatenate([wanted.com[0], wanted.orientation]), answered.forces.copy()
        if tracker.elevation is not None and observation.time_s >= self._map_due_s - 1e-9:
            self._map_due_s = observation.time_s + _MAP_S
            points = tracker.elevation.points(observation.state.position_world[:2], within_m=_MAP_M)
            self._maps.append((len(self._rows), points))
        self._rows.append((footholds, body, forces))

    def end(self) -> None:
        """Nothing to close."""

    def columns(self) -> PlanColumns | None:
        """What was kept; None of a walk that never began."""
        if not self._rows:
            return None
        footholds, body, forces = (np.stack(part) for part in zip(*self._rows, strict=True))
        return PlanColumns(footholds, body, forces, tuple(self._maps))
