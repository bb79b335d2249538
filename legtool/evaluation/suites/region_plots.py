"""Drawings of plans on regions from above: the regions, the torso's path, and the footholds along it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray

from legtool.sim.walks.pips import PlannedFrame

Array = NDArray[np.float64]

#: Left and right feet; regions that were seen, and those that are only assumed.
_SIDES = (("#1f5fa8", (0, 2)), ("#c4511c", (1, 3)))
_SEEN, _ASSUMED, _PATH = "#d6e4d2", "#ece7d0", "#2b7d4f"
_PIT = "#374151"


def paint_frame(ax: Axes, frame: PlannedFrame) -> None:
    """Draw one frame."""
    regions, answer = frame.regions, frame.answer
    ax.set_facecolor(_PIT)
    colours = np.where(regions.assumed, _ASSUMED, _SEEN)
    outlines = [regions.corners_world(k)[:, :2] for k in range(len(regions))]
    ax.add_collection(PolyCollection(outlines, facecolors=list(colours), edgecolors="#8aa18a", linewidths=0.3))
    ax.plot(*frame.position[:2], marker="o", color=_PATH, markersize=5)
    if answer.torso is not None:
        ax.plot(answer.torso.poses[:, 0], answer.torso.poses[:, 1], color=_PATH, linewidth=1.2)
    if answer.feet is not None:
        for colour, legs in _SIDES:
            for leg in legs:
                places = answer.feet.positions[:, leg]
                ax.plot(places[:, 0], places[:, 1], ".-", color=colour, markersize=4, linewidth=0.4)
    title = f"{frame.time_s:.1f} s: {len(regions)} regions, {answer.status}"
    ax.set_title(f"{title}, {answer.reason}" if answer.reason else title, loc="left", fontsize=7)
