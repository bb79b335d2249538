"""The memory of a search: its inputs, its nodes, its binary heap and its hash table, allocated once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.robot import TROT_PAIRS

Array = NDArray[np.float64]

#: Greatest number of nodes of one search: more than a search of 10 ms makes.
NODES = 1 << 16
NODE_BITS = 20
#: Bits of a table entry that hold the node.
NODE = (1 << NODE_BITS) - 1
#: Columns of a path: where each quantity of a step begins.
COMMAND, COST, POSITION, HEADING, VELOCITY, TOUCHDOWNS, CLEARANCE, MISS, _WIDTH = 0, 3, 4, 7, 8, 11, 17, 19, 21
_PAIRS = np.array(TROT_PAIRS)
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_HIGH = np.uint64(32)


class Terrain(NamedTuple):
    """A foot costmap as the search reads it; ``outside`` is the distance beyond the map."""

    distance: NDArray[np.float32]
    x0: float
    y0: float
    cells_per_m: float
    outside: float


class Task(NamedTuple):
    """Goal and settings of one search: metres, radians, seconds."""

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


class Workspace(NamedTuple):
    """All memory of a search. The first block is per node, the second heap and table, the third for one expansion."""

    position: Array  # world [m]
    yaw: Array  # since the start [rad]
    velocity: Array
    previous_velocity: Array
    feet: Array  # (n, 4, 3) world [m]
    clearance: Array  # (n, 2) distance of front and hind touchdown to the nearest unsafe cell [m]
    miss: Array  # (n, 2) probability that they come nearer than the margin
    cost: Array
    risk: Array  # what the footholds so far add to the cost [m]
    command: NDArray[np.int32]
    parent: NDArray[np.int32]
    depth: NDArray[np.int32]
    waited: NDArray[np.int32]  # steps of standing so far
    slot: NDArray[np.int32]
    heap: NDArray[np.int32]
    table: NDArray[np.int64]  # (slots, 2) key; number of the search that wrote it, and node, 0 once visited
    candidate: Array
    candidates: NDArray[np.int32]  # their indices
    step_feet: Array
    step_com: Array
    step_velocity: Array
    step_scale: Array
    features: Array
    rejected: NDArray[np.int64]  # (depth, leg) commands that the leg's touchdown forbade
    expanded: NDArray[np.int64]  # (depth,) nodes
    path: Array  # (step, 21) what comes back
    timespec: NDArray[np.int64]


def make_workspace(commands: int, horizon: int, breadth: int) -> Workspace:
    """Memory for searches with this many commands and steps, and at most so many nodes expanded at each depth.

    No larger than that asks for: what fits into the processor's caches is searched in half the time.
    """
    f, i = np.float64, np.int32
    n = min(NODES, 1 + commands * (1 + breadth * horizon))
    slots = 1 << n.bit_length() + 1  # at most half full
    shapes: list[tuple[Any, Any]] = [
        ((n, 3), f), ((n,), f), ((n, 3), f), ((n, 3), f), ((n, 4, 3), f), ((n, 2), f),
        ((n, 2), f), ((n,), f), ((n,), f), ((n,), i), ((n,), i), ((n,), i), ((n,), i),
        ((n,), i), ((n,), i), ((slots, 2), np.int64),
        ((commands, 3), f), ((commands,), i), ((commands, 4, 3), f), ((commands, 4), f), ((commands, 3), f),
        ((commands, 3), f), ((24,), f), ((horizon + 1, 4), np.int64), ((horizon + 1,), np.int64),
        ((horizon, _WIDTH), f), ((2,), np.int64),
    ]  # fmt: skip
    arrays = [np.empty(shape, dtype) for shape, dtype in shapes]
    for array in arrays:
        array.fill(0)  # the pages exist before the first search
    return Workspace(*arrays)


@kernel
def push(heap: NDArray[np.int32], cost: Array, size: int, node: int) -> None:
    """Put a node into a heap of ``size`` entries; it is younger than all of them."""
    k = size
    while k > 0:
        up = (k - 1) >> 1
        if cost[node] >= cost[heap[up]]:
            break
        heap[k] = heap[up]
        k = up
    heap[k] = node


@kernel
def pop(heap: NDArray[np.int32], cost: Array, size: int) -> int:
    """Take the cheapest node off a heap of ``size`` entries, of equal ones the oldest."""
    cheapest = heap[0]
    last = heap[size - 1]
    size -= 1
    k = 0
    while 2 * k + 1 < size:
        down = 2 * k + 1
        if down + 1 < size:
            left, right = heap[down], heap[down + 1]
            if cost[right] < cost[left] or (cost[right] == cost[left] and right < left):
                down += 1
        below = heap[down]
        if cost[last] < cost[below] or (cost[last] == cost[below] and last < below):
            break
        heap[k] = below
        k = down
    heap[k] = last
    return cheapest


@kernel
def find(table: NDArray[np.int64], key: int, search: int) -> int:
    """The slot of a key: the one that holds it in this search, or the free one where it belongs."""
    last = table.shape[0] - 1
    slot = np.int64((np.uint64(key) * _GOLDEN) >> _HIGH) & last
    while table[slot, 1] >> NODE_BITS == search and table[slot, 0] != key:
        slot = (slot + 1) & last
    return int(slot)


@kernel
def trace(commands: Array, swing_pair: int, last: int, w: Workspace) -> int:
    """Write the sequence that ends in a node to the rows of ``w.path``, and count its steps."""
    steps = w.depth[last]
    n = last
    for step in range(steps - 1, -1, -1):
        row = w.path[step]
        pair = (swing_pair + step) & 1
        for i in range(3):
            row[COMMAND + i] = commands[w.command[n], i]
            row[POSITION + i] = w.position[n, i]
            row[VELOCITY + i] = w.velocity[n, i]
            for side in range(2):
                row[TOUCHDOWNS + 3 * side + i] = w.feet[n, _PAIRS[pair, side], i]
        for side in range(2):
            row[CLEARANCE + side], row[MISS + side] = w.clearance[n, side], w.miss[n, side]
        row[COST], row[HEADING] = w.cost[n], w.yaw[n]
        n = w.parent[n]
    return steps
