"""What a node of the search costs: the way that is left, and what its footholds are worth (motion paper, III-B)."""

from __future__ import annotations

import math

import numpy as np

from legtool_runtime.cache import kernel
from legtool_runtime.motion.planning.problem import DistanceField, Task

_ROOT_HALF = math.sqrt(0.5)
#: A foot is taken never to stray by more standard deviations than this.
STRAYS = 4.0


@kernel
def wrap(angle: float) -> float:
    """The angle in [-π, π)."""
    return angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))


@kernel
def goal_distance(task: Task, x: float, y: float) -> float:
    """d_goal [m]."""
    return np.hypot(task.goal_x - x, task.goal_y - y)


@kernel
def heading_error(task: Task, x: float, y: float, heading: float) -> float:
    """How far the heading is from the goal's or, if it has none and the robot can turn, from the way there."""
    wanted = task.goal_heading
    if np.isnan(wanted):
        if not task.turns or goal_distance(task, x, y) <= task.near:
            return 0.0
        wanted = np.arctan2(task.goal_y - y, task.goal_x - x)
    return abs(wrap(wanted - heading))


@kernel
def remaining(task: Task, x: float, y: float, heading: float) -> float:
    """d_goal and what is off the heading [m]."""
    return goal_distance(task, x, y) + task.heading_weight * heading_error(task, x, y, heading)


@kernel
def distance_at(field: DistanceField, x: float, y: float) -> float:
    """Distance from the cell of a point to the nearest unsafe cell [m]."""
    nx, ny = field.distance.shape
    ix = int(np.floor((x - field.x0) * field.cells_per_m))
    iy = int(np.floor((y - field.y0) * field.cells_per_m))
    if 0 <= ix < nx and 0 <= iy < ny:
        return float(field.distance[ix, iy])
    return field.outside


@kernel
def miss(deviations: float) -> float:
    """Probability that a foot strays by more than this many standard deviations to one side."""
    return 0.5 * math.erfc(_ROOT_HALF * deviations)
