"""What a search is given, as compiled code takes it: the models, the start, where feet may stand, and the task.

Four tuples, no more: to hand a tuple to compiled code takes Python half a microsecond, and a plan is asked for often.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Models(NamedTuple):
    """The motion models, packed as in :attr:`.MotionModel.packed`, and the commands to choose from."""

    weights: Array
    covariance: Array  # of the FDM alone
    spread: Array  # (≥ horizon, 2) of :func:`.uncertainty.touchdown_variance` [m²]
    noise: Array  # (2,) of the same [m²]
    commands: Array  # (m, 3) vx, vy [m/s], yaw rate [rad/s]
    speeds: Array  # (m,) planar [m/s]


class Start(NamedTuple):
    """Where the search begins."""

    position: Array  # (3,) CoM, world frame [m]
    rotation: Array  # (3, 3) base to world
    features: Array  # (24,) in the order of FEATURES
    swing_pair: int  # that swings first


class DistanceField(NamedTuple):
    """A foot costmap: the distance of each cell to the nearest unsafe one [m]."""

    distance: NDArray[np.float32]  # (n_x, n_y)
    x0: float  # lower corner, world frame [m]
    y0: float
    cells_per_m: float
    half_cell: float  # side [m]
    outside: float  # distance beyond the map


class Task(NamedTuple):
    """Goal, settings and effort of one search: metres, radians, seconds."""

    goal_x: float
    goal_y: float
    goal_heading: float  # NaN where any will do
    turns: bool  # whether some command turns
    goal_tolerance: float
    heading_tolerance: float
    heading_weight: float
    d_max: float
    margin: float
    misstep_cost: float
    roll: float  # what a foot that bears load moves by, as a share of what the trunk travels
    waiting_cost: float
    max_change: float
    max_speed: float
    cell: float
    heading_bin: float
    headway: float  # least progress per step of a sequence that does not halt
    near: float  # this near the goal none halts
    horizon: int  # steps
    breadth: int  # nodes to expand at each depth
    insist: int  # nodes to expand after the first sequence that halts, in search of one that does not
    deadline: int  # time of :data:`.clock.CLOCK` [ns], or NEVER
