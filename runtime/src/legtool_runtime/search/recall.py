"""Candidates of earlier frames, for a robot that stands and finds no way on.

Each frame is segmented anew, and convex regions leave out other places each time. A robot that stands sees the same
ground again and again: what several frames offered, and the latest does not contradict, is offered.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.search.candidates import Candidates
from legtool_runtime.search.surface import Surface

Doubles = NDArray[np.float64]

#: Frames that are remembered, and how many of them must have offered a place.
_FRAMES, _LEAST = 12, 3


class Recall:
    """The candidates of the latest frames in which the robot stood."""

    def __init__(self) -> None:
        self._seen: deque[Candidates] = deque(maxlen=_FRAMES)

    @property
    def enough(self) -> bool:
        """Whether so many frames are remembered that something more is known than the latest one shows."""
        return len(self._seen) >= _LEAST

    def forget(self) -> None:
        """The robot walks: it sees other ground."""
        self._seen.clear()

    def note(self, found: Candidates) -> None:
        """One more frame."""
        self._seen.append(found)

    def more(self, found: Candidates, surface: Surface, step: float) -> Candidates:
        """A frame's candidates with those that it lacks and earlier ones offered, at the least of their margins.

        Args:
            found: of the latest frame.
            surface: of the latest frame: a place where another height is on top now is not offered.
            step: how much another height may differ [m].
        """
        if not self.enough:
            return found
        keys = np.concatenate([c.keys for c in self._seen])
        order = np.argsort(keys, kind="stable")
        kept, first, counts = np.unique(keys[order], return_index=True, return_counts=True)
        wanted = np.flatnonzero((counts >= _LEAST) & ~np.isin(kept, found.keys))
        margins = np.minimum.reduceat(np.concatenate([c.margins for c in self._seen])[order], first)[wanted]
        rows = order[(first + counts - 1)[wanted]]  # as they were offered last
        points = np.concatenate([c.points for c in self._seen])[rows]
        here = _agrees(surface, points, step)
        return Candidates(
            np.concatenate([found.points, points[here]]),
            np.concatenate([found.normals, np.concatenate([c.normals for c in self._seen])[rows][here]]),
            np.concatenate([found.margins, margins[here]]),
            np.concatenate([found.regions, np.full(int(here.sum()), -1)]),
            np.concatenate([found.keys, kept[wanted][here]]),
            np.concatenate([found.assumed, np.concatenate([c.assumed for c in self._seen])[rows][here]]),
            found.dropped,
        )


def _agrees(surface: Surface, points: Doubles, step: float) -> NDArray[np.bool_]:
    """(n,) at which of the points (n, 3) nothing that is known is off their heights by more than a step [m]."""
    n = surface.owner.shape[0]
    cells = np.floor(points[:, :2] / surface.cell).astype(np.int64) - surface.low
    inside = ((cells >= 0) & (cells < n)).all(axis=1)
    i, j = np.where(inside[:, None], cells, 0).T
    off = np.abs(surface.height[i, j] - points[:, 2]) > step  # never where no region is
    above = surface.ground.heights[i, j] > points[:, 2] + step
    return inside & ~off & ~above
