"""The cost-to-go field in compiled code: Dijkstra from the waypoint over a fine lattice of supported torso poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.search.supports import NOWHERE, YAWS, Supports, nearest_yaw, torso_height, yaw_of

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]
Ints = NDArray[np.int32]

#: Costs are whole numbers of so many metres, and edges cost less than so many of them.
_UNIT, _BUCKETS = 0.001, 256
#: How much farther than the start's cost the field goes on, and how much longer ways over a place may be [m].
_BEYOND, _DETOUR = 0.4, 0.8
#: What the lattice may add to a cost, in cells.
_LESS = 0.7
_STEPS_X = np.array([1, 1, 0, -1, -1, -1, 0, 1])
_STEPS_Y = np.array([0, 1, 1, 1, 0, -1, -1, -1])


class Field(NamedTuple):
    """Cost to go [m]: ``values`` (n, n, 16), each the least of the 3 × 3 cells around; a single cell: no field.
    ``low`` (2,) cell indices of the lower corner; ``cell`` [m]."""

    values: Floats
    low: NDArray[np.int64]
    cell: float


class FieldMemory(NamedTuple):
    """``cost`` (n · n · 16,) in units, ``state`` of support: 0 not looked at, 1 none, 2 supported, 3 done; ``rows``
    (n, n, 16); entries of the buckets: ``node``, ``next``; ``head``."""

    cost: Ints
    state: NDArray[np.int8]
    rows: Floats
    node: Ints
    next: Ints
    head: Ints


class FieldTask(NamedTuple):
    """To ``goal`` (2,) within ``tolerance`` [m] and, unless NaN, ``yaw`` within ``yaw_tolerance`` [rad], for poses
    around ``start`` (3,) x, y, yaw; a radian costs ``turn`` [m]."""

    goal: Doubles
    tolerance: float
    yaw: float
    yaw_tolerance: float
    start: Doubles
    turn: float


def no_field() -> Field:
    """The field that says nothing."""
    return Field(np.zeros((1, 1, 1), np.float32), np.zeros(2, np.int64), 1.0)


def field_memory(cells: int) -> FieldMemory:
    """Memory for fields of ``cells`` × ``cells`` places."""
    nodes = cells * cells * YAWS
    shape = (cells, cells, YAWS)
    return FieldMemory(
        np.zeros(nodes, np.int32), np.zeros(nodes, np.int8), np.zeros(shape, np.float32), np.zeros(4 * nodes, np.int32),
        np.zeros(4 * nodes, np.int32), np.zeros(_BUCKETS, np.int32),
    )  # fmt: skip


@kernel
def cost_to_go(field: Field, x: float, y: float, yaw: float) -> float:
    """Cost to go of a torso [m], less what the lattice adds; 0 outside."""
    i, j = int(np.floor(x / field.cell)) - field.low[0], int(np.floor(y / field.cell)) - field.low[1]
    n = field.values.shape[0]
    if not (0 <= i < n and 0 <= j < n):
        return 0.0
    return max(field.values[i, j, nearest_yaw(yaw)] - _LESS * field.cell, 0.0)


@kernel
def fill_field(task: FieldTask, s: Supports, field: Field, w: FieldMemory) -> int:
    """Fill the field. What is not reached costs at least as much as what was reached last.

    Returns:
        the number of poses whose cost is known.
    """
    n, cell = field.values.shape[0], field.cell
    never = 1 << 30
    w.cost[:], w.state[:], w.head[:] = never, 0, -1
    cost_of, state_of = w.cost, w.state
    used = _seed(task, s, field, w)
    way = np.hypot(task.start[0] - task.goal[0], task.start[1] - task.goal[1]) + _DETOUR
    si, sj = int(np.floor(task.start[0] / cell)) - field.low[0], int(np.floor(task.start[1] / cell)) - field.low[1]
    sk = nearest_yaw(task.start[2])
    straight, diagonal = int(cell / _UNIT + 0.5), int(np.sqrt(2.0) * cell / _UNIT + 0.5)
    turn = max(int(task.turn * 2.0 * np.pi / YAWS / _UNIT + 0.5), 1)
    last, known, empty, now = never, 0, 0, 0
    while empty < _BUCKETS and now <= last:
        bucket = now % _BUCKETS
        if w.head[bucket] < 0:
            now += 1
            empty += 1
            continue
        empty = 0
        e = w.head[bucket]
        w.head[bucket] = w.next[e]
        node = w.node[e]
        i, j, k = node // (YAWS * n), node // YAWS % n, node % YAWS
        if cost_of[node] != now or state_of[node] == 3:
            continue
        state_of[node] = 3
        known += 1
        if last == never and i == si and j == sj and k == sk:
            last = now + int(_BEYOND / _UNIT)
        for move in range(10):
            p, q, r, cost = i, j, k, turn
            if move < 8:
                p, q = i + _STEPS_X[move], j + _STEPS_Y[move]
                cost = diagonal if move & 1 else straight
                if not (0 <= p < n and 0 <= q < n):
                    continue
            else:
                r = (k + 2 * move - 17) % YAWS
            to = (p * n + q) * YAWS + r
            if cost_of[to] <= now + cost or used >= w.node.shape[0]:
                continue
            if state_of[to] < 2 and not _open(task, s, field, w, to, way):
                continue
            cost_of[to] = now + cost
            used = _queue(w, to, now + cost, used)
    _settle(field, w, now)
    return known


@kernel
def _queue(w: FieldMemory, node: int, cost: int, used: int) -> int:
    bucket = cost % _BUCKETS
    w.node[used], w.next[used] = node, w.head[bucket]
    w.head[bucket] = used
    return used + 1


@kernel
def _open(task: FieldTask, s: Supports, field: Field, w: FieldMemory, node: int, way: float) -> bool:
    """Whether a pose is supported and on a way that is not too long; looked at once."""
    if w.state[node] == 0:
        n = field.values.shape[0]
        i, j, k = node // (YAWS * n), node // YAWS % n, node % YAWS
        x, y = (field.low[0] + i + 0.5) * field.cell, (field.low[1] + j + 0.5) * field.cell
        w.state[node] = 1
        long = np.hypot(x - task.start[0], y - task.start[1]) + np.hypot(x - task.goal[0], y - task.goal[1]) > way
        if not long and torso_height(s, x, y, k)[0] > NOWHERE:
            w.state[node] = 2
    return w.state[node] >= 2


@kernel
def _seed(task: FieldTask, s: Supports, field: Field, w: FieldMemory) -> int:
    """Queue all supported poses at the waypoint; all of them where none is supported."""
    n, used = field.values.shape[0], 0
    reach = int(np.ceil(task.tolerance / field.cell))
    gi, gj = (
        int(np.floor(task.goal[0] / field.cell)) - field.low[0],
        int(np.floor(task.goal[1] / field.cell)) - field.low[1],
    )
    for supported in range(2):
        for i in range(max(gi - reach, 0), min(gi + reach + 1, n)):
            for j in range(max(gj - reach, 0), min(gj + reach + 1, n)):
                x, y = (field.low[0] + i + 0.5) * field.cell, (field.low[1] + j + 0.5) * field.cell
                if np.hypot(x - task.goal[0], y - task.goal[1]) > task.tolerance:
                    continue
                for k in range(YAWS):
                    off = yaw_of(k) - task.yaw
                    if abs(off - 2.0 * np.pi * np.round(off / (2.0 * np.pi))) > task.yaw_tolerance:  # never for NaN
                        continue
                    node = (i * n + j) * YAWS + k
                    if supported == 0 and not _open(task, s, field, w, node, np.inf):
                        continue
                    w.cost[node], w.state[node] = 0, 2
                    used = _queue(w, node, 0, used)
        if used > 0:
            break
    return used


@kernel
def _settle(field: Field, w: FieldMemory, most: int) -> None:
    """Write costs in metres, each the least of the 3 × 3 around; what was not reached costs ``most``."""
    n = field.values.shape[0]
    for i in range(n):
        for j in range(n):
            for k in range(YAWS):
                node = (i * n + j) * YAWS + k
                best = np.float32(w.cost[node])
                if j > 0:
                    best = min(best, np.float32(w.cost[node - YAWS]))
                if j + 1 < n:
                    best = min(best, np.float32(w.cost[node + YAWS]))
                w.rows[i, j, k] = min(best, np.float32(most)) * np.float32(_UNIT)
    for i in range(n):
        for j in range(n):
            for k in range(YAWS):
                best = w.rows[i, j, k]
                if i > 0:
                    best = min(best, w.rows[i - 1, j, k])
                if i + 1 < n:
                    best = min(best, w.rows[i + 1, j, k])
                field.values[i, j, k] = best
