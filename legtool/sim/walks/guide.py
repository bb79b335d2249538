"""Leads a walk through the places of a world, one after the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.sim.worlds.world import World

Array = NDArray[np.float64]

#: A place on the way is passed this near to it, where the goal has no radius [m].
_PASSED_M = 0.25


class Guide:
    """Knows which places have been passed."""

    def __init__(self, world: World) -> None:
        self._world, self._points, self._next = world, world.points(), 0
        self._radius = world.goal_radius_m or _PASSED_M

    @property
    def number(self) -> int:
        """Of the place that is walked to."""
        return self._next

    def target(self, position: ArrayLike) -> Array:
        """(2,) the place to walk to from a position (2,) or longer, x, y [m]; asked for at every place on the way."""
        here = np.asarray(position, dtype=float)[:2]
        while self._next + 1 < len(self._points) and np.hypot(*(self._points[self._next] - here)) <= self._radius:
            self._next += 1
        target: Array = self._points[self._next]
        return target

    def remaining(self, position: ArrayLike) -> float:
        """What is left of the way [m]; at most 0 where the goal is reached, all other places having been passed.

        Raises:
            SettingsError: the world has no goal.
        """
        target = self.target(position)
        if self._next + 1 == len(self._points):
            return self._world.remaining(position)
        ahead = self._points[self._next :]
        return float(np.hypot(*(target - np.asarray(position, dtype=float)[:2]))) + path_length(ahead)


def path_length(points: Array) -> float:
    """Length of a way through places (n, 2) [m]."""
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def progress(world: World, positions: Array) -> Array:
    """(n,) the share of the way that a walk has covered so far, 0 to 1, at positions (n, 2) or (n, 3), x, y [m].

    The way leads from the start along straight lines; at each place it is the most that has been reached of it. The
    goal's radius belongs to the goal.
    """
    points = np.concatenate([world.start[None, :2], world.points()])
    lengths = np.hypot(*np.diff(points, axis=0).T)
    total = max(float(lengths.sum()) - (world.goal_radius_m or 0.0), 1e-9)
    before = np.concatenate([[0.0], np.cumsum(lengths)])
    guide, most, out = Guide(world), 0.0, np.empty(len(positions))
    for k, position in enumerate(positions):
        guide.target(position)
        leg = guide.number
        along = points[leg + 1] - points[leg]
        share = float((position[:2] - points[leg]) @ along) / max(float(along @ along), 1e-12)
        most = max(most, before[leg] + min(max(share, 0.0), 1.0) * lengths[leg])
        out[k] = min(most / total, 1.0)
    return out
