"""What the foothold search is given, and what its parts measure alike: the feet of a stance, what is left, prices."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.search import feet_memory as memory
from legtool_runtime.search.body import TILT, Body
from legtool_runtime.search.feet_memory import FeetMemory
from legtool_runtime.search.field_kernels import Field, cost_to_go
from legtool_runtime.search.stances import HEADING, Rules
from legtool_runtime.tracking.ground import Ground
from legtool_runtime.tracking.reach import level_pose

Doubles = NDArray[np.float64]
Longs = NDArray[np.int64]

#: Bits of a key that hold the phase.
PHASE = (1 << memory.PHASE_BITS) - 1


class World(NamedTuple):
    """What the search stands on: ``points`` (n, 3), of which the last four are the feet as they stand; ``price`` (n,)
    of setting a foot there [m]; ``place`` (n,) keys; the ground; ``refused``: sorted signatures of transitions."""

    points: Doubles
    price: Doubles
    place: Longs
    ground: Ground
    trunk: Ground
    refused: Longs


class Gait(NamedTuple):
    """``legs`` (phases, sets, 2) of each swing set, -1 for none; ``sets`` (phases,) their number."""

    legs: Longs
    sets: Longs


class Task(NamedTuple):
    """What is wanted: torso at ``goal`` (3,) within ``tolerance`` [m] and, unless NaN, heading ``yaw`` [rad] within
    ``yaw_tolerance``; starting with ``phase``; ``weight`` of the heuristic; ``progress`` that makes a partial path [m];
    ``most``: stances to be expanded."""

    goal: Doubles
    tolerance: float
    yaw: float
    yaw_tolerance: float
    phase: int
    weight: float
    progress: float
    deadline: int
    most: int


@kernel
def places_of(world: World, feet: NDArray[np.int32], out: Doubles) -> Doubles:
    """Write the places (4, 3) of feet (4,)."""
    for leg in range(4):
        for i in range(3):
            out[leg, i] = world.points[feet[leg], i]
    return out


@kernel
def pose_feet(body: Body, w: FeetMemory) -> None:
    """Make ``w.scratch``'s feet their centres and its pose the one that they imply, as the tracker's reference does."""
    s = w.scratch
    for leg in range(4):
        s.feet[leg, 2] += body.radius
    level_pose(s.feet, s.weights, body.height, TILT, s.pose)


@kernel
def to_go(task: Task, per_step: float, field: Field, shape: Doubles, above: float, stride: float) -> float:
    """A lower bound of the cost to the waypoint: the straight way and its transitions, or what the field says."""
    dx, dy = task.goal[0] - shape[0], task.goal[1] - shape[1]
    dz = task.goal[2] - shape[2] - above
    far = max(np.sqrt(dx * dx + dy * dy + dz * dz) - task.tolerance, 0.0)
    if field.values.shape[0] > 1:
        far = max(far, cost_to_go(field, shape[0], shape[1], np.arctan2(shape[HEADING + 1], shape[HEADING])))
    return far + per_step * np.ceil(far / stride - 1e-9)


@kernel
def distance(world: World, a: int, b: int) -> float:
    """Between two candidates [m]."""
    dx, dy = world.points[a, 0] - world.points[b, 0], world.points[a, 1] - world.points[b, 1]
    dz = world.points[a, 2] - world.points[b, 2]
    return np.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def moved(world: World, a: int, b: int) -> tuple[float, float, float]:
    """From one candidate to another [m]."""
    return (
        world.points[b, 0] - world.points[a, 0],
        world.points[b, 1] - world.points[a, 1],
        world.points[b, 2] - world.points[a, 2],
    )


@kernel
def price_of(world: World, rules: Rules, a: int, b: int) -> float:
    """What a swing from one candidate to another costs, apart from the torso's way; nothing for one that stays."""
    if a == b:
        return 0.0
    return world.price[b] + 0.25 * rules.climb_m * abs(world.points[b, 2] - world.points[a, 2])
