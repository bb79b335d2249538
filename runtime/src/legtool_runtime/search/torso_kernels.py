"""The torso search in compiled code: A* over a lattice of poses that stand over ground (VI-B)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.motion.planning.workspace import pop, push
from legtool_runtime.search.supports import NOWHERE, YAWS, Supports, nearest_yaw, torso_height, yaw_of

Doubles = NDArray[np.float64]
Ints = NDArray[np.int32]

#: Steps to the eight neighbours of a cell, counter-clockwise from +x.
_STEPS_X = np.array([1, 1, 0, -1, -1, -1, 0, 1])
_STEPS_Y = np.array([0, 1, 1, 1, 0, -1, -1, -1])
#: Poses that are closed at most.
_MOST = 20000


class TorsoTask(NamedTuple):
    """From ``start`` (4,) x, y, z, yaw to ``goal`` (2,) within ``tolerance`` [m], heading ``yaw`` unless NaN, in a
    lattice of ``cell`` [m] within ``reach`` [m]; costs as in :class:`.TorsoSettings`; ``tabu`` (k, 4): x, y, yaw and
    penalty of waypoints that led nowhere; ``kept`` (4,): those of the last end, and by how much it is worth more."""

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
    kept: Doubles


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
    m = _side(w)
    w.height[:], w.cost[:], w.closed[:] = np.nan, np.inf, False
    low_x, low_y = _corner(task, m)
    root = (m // 2 * m + m // 2) * YAWS + nearest_yaw(task.start[3])
    w.height[root], w.unseen[root], w.cost[root], w.parent[root] = task.start[2], 0.0, 0.0, -1
    entries, size, expanded = 1, 1, 0
    w.f[0], w.node[0], w.heap[0] = 0.0, root, 0
    nearest, lengths = _nearest(task, s), _lengths(task)
    best, best_worth, promised = root, np.inf, task.kept[3]
    while size > 0 and expanded < _MOST:
        e = pop(w.heap, w.f, size)
        size -= 1
        n = w.node[e]
        if w.closed[n]:
            continue
        if w.f[e] + (task.greed - 1.0) * nearest - promised >= best_worth:  # as what _leave leaves out
            break
        w.closed[n] = True
        expanded += 1
        i, j, k = n // (YAWS * m), n // YAWS % m, n % YAWS
        x, y = (low_x + i + 0.5) * task.cell, (low_y + j + 0.5) * task.cell
        if n == root:  # where the robot is, not where its cell is
            x, y = task.start[0], task.start[1]
        worth = w.cost[n] + task.greed * _left(task, x, y, k) + _tabu(task, x, y, k)
        kept = k == nearest_yaw(task.kept[2]) and np.hypot(x - task.kept[0], y - task.kept[1]) < 0.5 * task.cell
        if promised > 0.0 and kept:
            worth, promised = worth - promised, 0.0
        if worth < best_worth:
            best, best_worth = n, worth
        worse = (best_worth, (task.greed - 1.0) * nearest, promised)
        size, entries = _leave(task, s, w, (n, i, j, k), (m, low_x, low_y), lengths, worse, size, entries)
    count, n = 0, best
    while n >= 0:
        count += 1
        n = w.parent[n]
    n = best
    for k in range(count - 1, -1, -1):
        w.path[k] = n
        n = w.parent[n]
    if best == root:
        return count, expanded, _left(task, task.start[0], task.start[1], nearest_yaw(task.start[3]))
    i, j = best // (YAWS * m), best // YAWS % m
    return count, expanded, _left(task, (low_x + i + 0.5) * task.cell, (low_y + j + 0.5) * task.cell, best % YAWS)


@kernel
def _leave(
    task: TorsoTask,
    s: Supports,
    w: TorsoMemory,
    node: tuple[int, int, int, int],
    lattice: tuple[int, int, int],
    lengths: Doubles,
    worse: tuple[float, float, float],
    size: int,
    entries: int,
) -> tuple[int, int]:
    """Queue the neighbours of a node (its number, cell and heading); the new sizes of heap and of entries.

    ``worse`` is the worth of the best end so far, what the worth of others is at least above their f, and what the end
    of the last path may still be worth more: what cannot be better is left out, as it would never come off the queue.
    """
    n, i, j, k = node
    m, low_x, low_y = lattice
    best, above, promised = worse
    turn, wanted = task.turn * 2.0 * np.pi / YAWS, not np.isnan(task.yaw)
    cost_of, from_cost = w.cost, w.cost[n]
    for way in range(9):
        p, q, flat = i, j, 0.0
        if way < 8:
            p, q, flat = i + _STEPS_X[way], j + _STEPS_Y[way], lengths[k, way]
            if not (0 <= p < m and 0 <= q < m):
                continue
        x, y, left = (low_x + p + 0.5) * task.cell, (low_y + q + 0.5) * task.cell, -1.0
        for turned in range(-1, 2):
            r = (k + turned) & (YAWS - 1)
            to = (p * m + q) * YAWS + r
            cost = from_cost + flat + turn * abs(turned)
            if cost >= cost_of[to] - 1e-12 or w.closed[to]:
                continue
            if left < 0.0 or wanted:
                left = _left(task, x, y, r)
            if cost + left + above - promised >= best or not _supported(task, s, w, to, x, y, r):
                continue
            rise = w.height[to] - w.height[n]
            if abs(rise) > 1e-3:
                cost += (np.sqrt(1.0 + (rise / task.cell) ** 2) - 1.0) * flat
            cost += task.unseen * w.unseen[to] * flat
            if cost < cost_of[to] - 1e-12 and entries < w.f.shape[0]:
                cost_of[to], w.parent[to] = cost, n
                w.f[entries], w.node[entries] = cost + left, to
                push(w.heap, w.f, size, entries)
                size, entries = size + 1, entries + 1
    return size, entries


@kernel
def pose_of(task: TorsoTask, w: TorsoMemory, n: int, out: Doubles) -> None:
    """Write the pose (4,) x, y, z, yaw of a node."""
    m = _side(w)
    low_x, low_y = _corner(task, m)
    out[0], out[1] = (low_x + n // (YAWS * m) + 0.5) * task.cell, (low_y + n // YAWS % m + 0.5) * task.cell
    out[2], out[3] = w.height[n], yaw_of(n % YAWS)


@kernel
def _side(w: TorsoMemory) -> int:
    """Cells of the lattice on each side."""
    return int(np.round(np.sqrt(w.height.shape[0] / YAWS)))


@kernel
def _corner(task: TorsoTask, m: int) -> tuple[int, int]:
    """Cell indices of the lattice's lower corner: the start lies in its middle cell."""
    return int(np.floor(task.start[0] / task.cell)) - m // 2, int(np.floor(task.start[1] / task.cell)) - m // 2


@kernel
def _lengths(task: TorsoTask) -> Doubles:
    """(16, 8) lengths of steps on level ground by heading and way, longer where they lead off the heading [m]."""
    out = np.empty((YAWS, 8))
    for k in range(YAWS):
        for way in range(8):
            off = abs(_wrapped(way * np.pi / 4 - yaw_of(k)))
            out[k, way] = task.cell * (np.sqrt(2.0) if way & 1 else 1.0)
            out[k, way] *= task.sideways if off > np.pi / 4 + 1e-6 else 1.0
    return out


@kernel
def _wrapped(angle: float) -> float:
    return angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi))


@kernel
def _left(task: TorsoTask, x: float, y: float, k: int) -> float:
    """Lower bound of the cost from a pose to the goal."""
    far = max(np.sqrt((x - task.goal[0]) ** 2 + (y - task.goal[1]) ** 2) - task.tolerance, 0.0)
    if not np.isnan(task.yaw):
        far += task.turn * max(abs(_wrapped(yaw_of(k) - task.yaw)) - np.pi / YAWS, 0.0)
    return far


@kernel
def _tabu(task: TorsoTask, x: float, y: float, k: int) -> float:
    """Penalty of a waypoint near one that led nowhere: within 0.3 m and π/4."""
    total = 0.0
    for n in range(task.tabu.shape[0]):
        near = np.hypot(x - task.tabu[n, 0], y - task.tabu[n, 1]) <= 0.3
        if near and abs(_wrapped(yaw_of(k) - task.tabu[n, 2])) <= np.pi / 4:
            total += task.tabu[n, 3]
    return total


@kernel
def _nearest(task: TorsoTask, s: Supports) -> float:
    """How near to the goal a torso can come: the feet nearest to it stand nearer than the torso."""
    best = np.inf
    for i in range(s.height.shape[0]):
        dx = (s.low[0] + i + 0.5) * s.cell - task.goal[0]
        for j in range(s.height.shape[1]):
            if not np.isnan(s.height[i, j]):
                dy = (s.low[1] + j + 0.5) * s.cell - task.goal[1]
                best = min(best, dx * dx + dy * dy)
    within = np.hypot(task.start[0] - task.goal[0], task.start[1] - task.goal[1]) - task.reach - task.cell
    least = max(within, np.sqrt(best) if np.isfinite(best) else 0.0)
    return max(least - task.tolerance, 0.0)


@kernel
def _supported(task: TorsoTask, s: Supports, w: TorsoMemory, n: int, x: float, y: float, k: int) -> bool:
    """Whether a node lies within reach and stands over ground; looked at once."""
    if np.isnan(w.height[n]):
        if np.hypot(x - task.start[0], y - task.start[1]) > task.reach:
            w.height[n] = NOWHERE
        else:
            w.height[n], w.unseen[n] = torso_height(s, x, y, k)
    return w.height[n] > NOWHERE
