"""The memory of a search: its nodes, its binary heap and its hash table, allocated once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.motion.kernels import MONOMIALS, OUTPUTS
from legtool_runtime.motion.planning.clock import WATCH
from legtool_runtime.motion.planning.plan import MAX_HORIZON
from legtool_runtime.robot import TROT_PAIRS

Array = NDArray[np.float64]
Records = NDArray[Any]

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

#: The full stance that a sequence of commands leads to; one record. World frame, metres, radians.
_NODE = np.dtype(
    [
        ("position", "f8", (3,)),
        ("yaw", "f8"),  # since the start
        ("velocity", "f8", (3,)),
        ("previous_velocity", "f8", (3,)),
        ("reference", "f8", (3,)),  # the command that led here
        ("feet", "f8", (4, 3)),
        ("clearance", "f8", (2,)),  # of front and hind touchdown to the nearest unsafe cell
        ("miss", "f8", (2,)),  # probability that they come nearer than the margin
        ("risk", "f8"),  # what the footholds so far add to the cost
        ("parent", "i4"),
        ("depth", "i4"),
        ("waited", "i4"),  # steps of standing so far
        ("slot", "i4"),  # of the table
    ],
    align=True,
)

#: How far a search has come; one record.
_PROGRESS = np.dtype(
    [
        ("number", "i8"),  # of the search
        ("nodes", "i8"),  # made; the record behind them is free for the next
        ("open", "i8"),  # entries of the heap
        ("expanded", "i8"),  # nodes
        ("expanded_at", "i8", (MAX_HORIZON + 1,)),  # the same by depth
        ("rejected", "i8", (MAX_HORIZON + 1, 4)),  # by depth and leg: commands that the leg's touchdown forbade
        ("best", "i8"),  # the deepest node, of equal ones the cheapest
        ("best_depth", "i8"),
        ("halted", "i8"),  # the first full sequence that makes no headway; 0 for none
        ("enough", "i8"),  # expanded nodes after which it is taken
        ("cut", "i8"),  # whether a node was left out because its depth had enough
        ("swing_pair", "i8"),  # of the first step
        ("rotation", "f8", (3, 3)),  # of the start
        ("max_change", "f8"),  # of the first command
        ("heading", "f8"),  # of the start
        ("remaining", "f8"),  # from the start
        ("cell", "i8", (2,)),  # of the start
    ],
    align=True,
)

#: One expansion, and the candidate at hand; one record.
_EXPANSION = np.dtype(
    [
        ("depth", "i8"),
        ("pair", "i8"),  # that swings
        ("turned", "f8", (3, 3)),  # base to world
        ("features", "f8", (24,)),
        ("monomials", "i8"),  # of the reference: 4 or 10
        ("table", "f8", (MONOMIALS, OUTPUTS)),  # of kernels.mean_table
        ("scaled", "i8"),  # whether the next is known
        ("scale_table", "f8", (MONOMIALS, MONOMIALS)),  # of the FDM
        ("spread", "f8", (2,)),  # variance of both touchdowns where the FDM knows all [m²]
        ("noise", "f8", (2,)),  # the part of it that grows with what the FDM does not know [m²]
        ("reach", "f8", (2,)),  # what the touchdowns may stray by [m]
        ("m", "f8", (MONOMIALS,)),  # the command's monomials
        ("step", "f8", (OUTPUTS,)),  # of kernels.mean
        ("roll", "f8", (2,)),  # of feet that bear load [m]
        ("landed", "f8", (2,)),  # distance of the touchdowns to the nearest unsafe cell [m]
        ("spare", "f8", (2,)),  # what is left of their clearance beyond the margin [m]
    ],
    align=True,
)


class Workspace(NamedTuple):
    """All memory of a search. What needs no more than a record is one: compiled code hands it on for nothing."""

    nodes: Records
    cost: Array  # of the nodes: apart from them, since the heap reads nothing else
    heap: NDArray[np.int32]
    table: NDArray[np.int64]  # (slots, 2) key; number of the search that wrote it, and node, 0 once visited
    candidates: NDArray[np.int32]  # commands of one expansion
    expansion: Records  # (1,)
    progress: Records  # (1,)
    path: Array  # (step, 21) what comes back
    watch: NDArray[np.int64]


def make_workspace(commands: int, horizon: int, breadth: int) -> Workspace:
    """Memory for searches with this many commands and steps, and at most so many nodes expanded at each depth.

    No larger than that asks for: what fits into the processor's caches is searched in half the time.
    """
    n = min(NODES, 1 + commands * (1 + breadth * horizon))
    slots = 1 << n.bit_length() + 1  # at most half full
    return Workspace(
        nodes=_zeros(n, _NODE),
        cost=_zeros(n),
        heap=_zeros(n, np.int32),
        table=_zeros((slots, 2), np.int64),
        candidates=_zeros(commands, np.int32),
        expansion=_zeros(1, _EXPANSION),
        progress=_zeros(1, _PROGRESS),
        path=_zeros((horizon, _WIDTH)),
        watch=_zeros(WATCH, np.int64),
    )


def _zeros(shape: int | tuple[int, ...], dtype: Any = np.float64) -> Any:
    """Zeros that are written, so that their pages exist before the first search."""
    array = np.empty(shape, dtype)
    array[...] = np.zeros((), dtype)
    return array


@kernel
def push(heap: NDArray[np.int32], cost: Array, size: int, node: int) -> None:
    """Put a node into a heap of ``size`` entries; it is younger than all of them."""
    k, up = size, (size - 1) >> 1
    while k > 0 and cost[node] < cost[heap[up]]:
        heap[k] = heap[up]
        k, up = up, (up - 1) >> 1
    heap[k] = node


@kernel
def pop(heap: NDArray[np.int32], cost: Array, size: int) -> int:
    """Take the cheapest node off a heap of ``size`` entries, of equal ones the oldest."""
    cheapest, last = heap[0], heap[size - 1]
    k, down = 0, _below(heap, cost, size - 1, 0)
    while down < size - 1 and _sooner(cost, heap[down], last):
        heap[k] = heap[down]
        k, down = down, _below(heap, cost, size - 1, down)
    heap[k] = last
    return cheapest


@kernel
def _below(heap: NDArray[np.int32], cost: Array, size: int, k: int) -> int:
    """Which of the two entries below entry ``k`` comes first; at least ``size`` if there is none."""
    down = 2 * k + 1
    if down + 1 < size:
        return down + _sooner(cost, heap[down + 1], heap[down])
    return down


@kernel
def _sooner(cost: Array, one: int, other: int) -> bool:
    """Whether a node comes before another: the cheaper, of equal ones the older."""
    return (cost[one] < cost[other]) | ((cost[one] == cost[other]) & (one < other))


@kernel
def find(table: NDArray[np.int64], key: int, search: int) -> int:
    """The slot of a key: the one that holds it in this search, or the free one where it belongs."""
    last = table.shape[0] - 1
    slot = np.int64((np.uint64(key) * _GOLDEN) >> _HIGH) & last
    while table[slot, 1] >> NODE_BITS == search and table[slot, 0] != key:
        slot = (slot + 1) & last
    return int(slot)


@kernel
def trace(swing_pair: int, last: int, w: Workspace) -> int:
    """Write the sequence that ends in a node to the rows of ``w.path``, and count its steps."""
    steps = w.nodes[last].depth
    n = last
    for step in range(steps - 1, -1, -1):
        row, node = w.path[step], w.nodes[n]
        pair = (swing_pair + step) & 1
        for i in range(3):
            row[COMMAND + i] = node.reference[i]
            row[POSITION + i] = node.position[i]
            row[VELOCITY + i] = node.velocity[i]
            for side in range(2):
                row[TOUCHDOWNS + 3 * side + i] = node.feet[_PAIRS[pair, side], i]
        for side in range(2):
            row[CLEARANCE + side], row[MISS + side] = node.clearance[side], node.miss[side]
        row[COST], row[HEADING] = w.cost[n], node.yaw
        n = node.parent
    return steps
