"""The torso search in compiled code: A* over a lattice of poses that stand over ground (VI-B)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.motion.planning.workspace import pop, push
from legtool_runtime.search.supports import NOWHERE, YAWS, Supports, torso_height

Doubles = NDArray[np.float64]
Ints = NDArray[np.int32]

#: Steps to the eight neighbours of a cell, counter-clockwise from +x.
_STEPS_X = np.array([1, 1, 0, -1, -1, -1, 0, 1])
_STEPS_Y = np.array([0, 1, 1, 1, 0, -1, -1, -1])
#: Stances that are closed at most.
_MOST = 20000


class TorsoTask(NamedTuple):
    """From ``start`` (4,) x, y, z, yaw to ``goal`` (2,) within ``tolerance`` [m], heading ``yaw`` unless NaN, in a
    lattice of ``cell`` [m] within ``reach`` [m]; costs as in :class:`.TorsoSettings`; ``tabu`` (k, 4): x, y, yaw and
    penalty of waypoints that led nowhere."""

    start: Doubles
    goal: Doubles
    yaw: float
    tolerance: float
    cell: float
    reach: float
    turn: float
    unseen: float
    sideways: float
    greed: float
    tabu: Doubles


class TorsoMemory(NamedTuple):
    """Of lattice nodes: ``height`` of the base, NaN unless looked at, ``unseen`` share, ``cost``, ``parent``,
    ``closed``; of queued entries: ``f``, ``node``, ``heap``; ``path`` of nodes."""

    height: Doubles
    unseen: Doubles
    cost: Doubles
    parent: Ints
    closed: NDArray[np.bool_]
    f: Doubles
    node: Ints
    heap: Ints
    path: Ints


def torso_memory(reach: float, cell: float) -> TorsoMemory:
    """Memory for searches that reach so far on a lattice of such cells [m]."""
    m = 2 * int(np.ceil(reach / cell)) + 1
    nodes, entries = m * m * YAWS, 8 * m * m * YAWS
    return TorsoMemory(
        np.zeros(nodes), np.zeros(nodes), np.zeros(nodes), np.zeros(nodes, np.int32), np.zeros(nodes, np.bool_),
        np.zeros(entries), np.zeros(entries, np.int32), np.zeros(entries, np.int32), np.zeros(nodes, np.int32),
    )  # fmt: skip


@kernel
def search_torso(task: TorsoTask, s: Supports, w: TorsoMemory) -> tuple[int, int, float]:
    """The path that is worth most: to the goal, or to the pose from which the rest of the way is least.

    The end minimises its path's cost + greed · (distance to the goal - tolerance): greed 1 would never leave, for a
    detour costs more than it brings. The queue is ordered by the cost + that distance; what is left in it can end no
    better than its first + (greed - 1) · the least distance that ground allows.

    Returns:
        the number of nodes in ``w.path``, start first, how many were expanded, and how far the end is from the goal.
    """
    m = int(round(np.sqrt(w.height.shape[0] // YAWS)))
    w.height[:], w.cost[:], w.closed[:] = np.nan, np.inf, False
    half = m // 2
    low_x, low_y = int(np.floor(task.start[0] / task.cell)) - half, int(np.floor(task.start[1] / task.cell)) - half
    k0 = int(np.round((task.start[3] + np.pi) / (2.0 * np.pi / YAWS))) % YAWS
    root = (half * m + half) * YAWS + k0
    w.height[root], w.unseen[root], w.cost[root], w.parent[root] = task.start[2], 0.0, 0.0, -1
    entries, size, expanded = 1, 1, 0
    w.f[0], w.node[0], w.heap[0] = _left(task, root, m, low_x, low_y), root, 0
    nearest = _nearest(task, s)
    best, best_worth = root, np.inf
    while size > 0 and expanded < _MOST:
        e = pop(w.heap, w.f, size)
        size -= 1
        n = w.node[e]
        if w.closed[n]:
            continue
        if w.f[e] + (task.greed - 1.0) * nearest >= best_worth:
            break
        w.closed[n] = True
        expanded += 1
        worth = w.cost[n] + task.greed * _left(task, n, m, low_x, low_y) + _tabu(task, n, m, low_x, low_y)
        if worth < best_worth:
            best, best_worth = n, worth
        i, j, k = n // (YAWS * m), n // YAWS % m, n % YAWS
        for way in range(9):
            for turned in range(-1, 2):
                if way == 8 and turned == 0:
                    continue
                p = i + (_STEPS_X[way] if way < 8 else 0)
                q = j + (_STEPS_Y[way] if way < 8 else 0)
                if not (0 <= p < m and 0 <= q < m):
                    continue
                r = (k + turned) % YAWS
                to = (p * m + q) * YAWS + r
                if w.closed[to] or not _supported(task, s, w, to, m, low_x, low_y):
                    continue
                cost = w.cost[n] + _cost(task, w, n, to, way, k, turned)
                if cost < w.cost[to] - 1e-12 and entries < w.f.shape[0]:
                    w.cost[to], w.parent[to] = cost, n
                    w.f[entries], w.node[entries] = cost + _left(task, to, m, low_x, low_y), to
                    push(w.heap, w.f, size, entries)
                    size += 1
                    entries += 1
    count, n = 0, best
    while n >= 0:
        count += 1
        n = w.parent[n]
    n = best
    for k in range(count - 1, -1, -1):
        w.path[k] = n
        n = w.parent[n]
    return count, expanded, _left(task, best, m, low_x, low_y)


@kernel
def pose_of(task: TorsoTask, w: TorsoMemory, n: int, out: Doubles) -> None:
    """Write the pose (4,) x, y, z, yaw of a node."""
    m = int(round(np.sqrt(w.height.shape[0] // YAWS)))
    half = m // 2
    low_x, low_y = int(np.floor(task.start[0] / task.cell)) - half, int(np.floor(task.start[1] / task.cell)) - half
    out[0], out[1] = _place(task, n, m, low_x, low_y)
    out[2], out[3] = w.height[n], -np.pi + (n % YAWS) * 2.0 * np.pi / YAWS


@kernel
def _place(task: TorsoTask, n: int, m: int, low_x: int, low_y: int) -> tuple[float, float]:
    return (low_x + n // (YAWS * m) + 0.5) * task.cell, (low_y + n // YAWS % m + 0.5) * task.cell


@kernel
def _wrapped(angle: float) -> float:
    return angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi))


@kernel
def _left(task: TorsoTask, n: int, m: int, low_x: int, low_y: int) -> float:
    """Lower bound of the cost from a node to the goal."""
    x, y = _place(task, n, m, low_x, low_y)
    far = max(np.hypot(x - task.goal[0], y - task.goal[1]) - task.tolerance, 0.0)
    if not np.isnan(task.yaw):
        off = abs(_wrapped(-np.pi + (n % YAWS) * 2.0 * np.pi / YAWS - task.yaw))
        far += task.turn * max(off - np.pi / YAWS, 0.0)
    return far


@kernel
def _tabu(task: TorsoTask, n: int, m: int, low_x: int, low_y: int) -> float:
    """Penalty of a waypoint near one that led nowhere: within 0.3 m and π/4."""
    x, y = _place(task, n, m, low_x, low_y)
    yaw, total = -np.pi + (n % YAWS) * 2.0 * np.pi / YAWS, 0.0
    for k in range(task.tabu.shape[0]):
        if np.hypot(x - task.tabu[k, 0], y - task.tabu[k, 1]) <= 0.3 and abs(_wrapped(yaw - task.tabu[k, 2])) <= np.pi / 4:
            total += task.tabu[k, 3]
    return total


@kernel
def _nearest(task: TorsoTask, s: Supports) -> float:
    """How near to the goal a torso can come: the feet nearest to it stand nearer than the torso."""
    best = np.inf
    for i in range(s.height.shape[0]):
        for j in range(s.height.shape[1]):
            if np.isfinite(s.height[i, j]):
                x, y = (s.low[0] + i + 0.5) * s.cell, (s.low[1] + j + 0.5) * s.cell
                best = min(best, np.hypot(x - task.goal[0], y - task.goal[1]))
    within = np.hypot(task.start[0] - task.goal[0], task.start[1] - task.goal[1]) - task.reach - task.cell
    least = max(within, best if np.isfinite(best) else 0.0)
    return max(least - task.tolerance, 0.0)


@kernel
def _supported(task: TorsoTask, s: Supports, w: TorsoMemory, n: int, m: int, low_x: int, low_y: int) -> bool:
    """Whether a node lies within reach and stands over ground; looked at once."""
    if np.isnan(w.height[n]):
        x, y = _place(task, n, m, low_x, low_y)
        if np.hypot(x - task.start[0], y - task.start[1]) > task.reach:
            w.height[n] = NOWHERE
        else:
            w.height[n], w.unseen[n] = torso_height(s, x, y, -np.pi + (n % YAWS) * 2.0 * np.pi / YAWS)
    return w.height[n] > NOWHERE


@kernel
def _cost(task: TorsoTask, w: TorsoMemory, n: int, to: int, way: int, yaw: int, turned: int) -> float:
    """Of an edge: distance, turning, ground that is only assumed."""
    cost = task.turn * abs(turned) * 2.0 * np.pi / YAWS
    if way < 8:
        flat = task.cell * (np.sqrt(2.0) if way & 1 else 1.0)
        off = _wrapped(way * np.pi / 4 - (-np.pi + yaw * 2.0 * np.pi / YAWS))
        rise = w.height[to] - w.height[n]
        length = np.sqrt(flat * flat + rise * rise)
        cost += length * (task.sideways if abs(off) > np.pi / 4 + 1e-6 else 1.0)
        cost += task.unseen * w.unseen[to] * flat
    return cost
