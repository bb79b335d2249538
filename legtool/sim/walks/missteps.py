"""Missteps: feet that stand where there is no ground for a foot, or near its edges, judged on the true state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.sim.controllers.trot.gait import GRAVITY
from legtool.sim.walks.environment import Answer, Observation
from legtool.sim.walks.simulated import CHECK_EVERY, SimulatedRobot

#: Share of the robot's weight above which a foot is loaded.
LOADED = 0.08
#: A foot that bears load for this long off the ground stands there; a toe that brushes a riser in passing does not [s].
STANDS_S = 0.03
#: A foot that has borne load for so long has come to stand [s]; it stands near an edge where so far around it there is
#: no ground for a foot [m].
_STOOD_S, EDGE_M = 0.05, 0.01
_AROUND = EDGE_M * np.array([[np.cos(a), np.sin(a), 0.0] for a in np.arange(8) * np.pi / 4])


class Missteps:
    """Notes each foot that begins to stand off the ground; a :class:`.Subscriber`.

    Attributes:
        found: when [s], where (x, y) in the world [m], and which leg.
        edges: the same of each foot that came to stand on ground within ``EDGE_M`` of an edge.
    """

    def __init__(self, environment: SimulatedRobot) -> None:
        self.found: list[tuple[float, float, float, int]] = []
        self.edges: list[tuple[float, float, float, int]] = []
        assert environment.world is not None
        self._environment, self._world = environment, environment.world
        self._loaded = LOADED * environment.simulation.robot.mass * GRAVITY
        self._off_s, self._loaded_s = np.zeros(4), np.zeros(4)

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """Look at the feet on every other tick."""
        del observation, answer
        environment = self._environment
        if (environment.simulation.tick - 1) % CHECK_EVERY:
            return
        feet, forces = environment.feet()
        off = forces > self._loaded
        self._look_around(feet, off)
        if off.any():
            off &= ~self._world.on_ground(feet)
        before = self._off_s
        self._off_s = np.where(off, before + CHECK_EVERY / CONTROL_RATE_HZ, 0.0)
        for leg in np.flatnonzero((before < STANDS_S) & (self._off_s >= STANDS_S)):
            self.found.append((environment.time_s, float(feet[leg, 0]), float(feet[leg, 1]), int(leg)))

    def _look_around(self, feet: NDArray[np.float64], loaded: NDArray[np.bool_]) -> None:
        """Note feet that come to stand near an edge."""
        before = self._loaded_s
        self._loaded_s = np.where(loaded, before + CHECK_EVERY / CONTROL_RATE_HZ, 0.0)
        for leg in np.flatnonzero((before < _STOOD_S) & (self._loaded_s >= _STOOD_S)):
            if self._world.on_ground(feet[leg][None])[0] and not self._world.on_ground(feet[leg] + _AROUND).all():
                self.edges.append((self._environment.time_s, float(feet[leg, 0]), float(feet[leg, 1]), int(leg)))

    def end(self) -> None:
        """Nothing to close."""
