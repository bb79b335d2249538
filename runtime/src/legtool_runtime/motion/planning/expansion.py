"""The steps that lead on from a node: where the feet come down, what that risks and costs, which nodes are new.

- A foot rolls while it bears load: its centre moves by foot radius over standing height of what the trunk travels. A
  foothold is as far from an unsafe cell as the nearer of where the foot lands and where it will have rolled to, the
  coming step being taken to lead as far as this one.
- What a foothold risks stays with the sequence: the probability that the foot lands nearer than the margin to an unsafe
  cell, given the models' spread, adds to the cost of the node and of all that follow. So one search finds wide margins
  where there are any, and narrow ones where nothing else leads on.

A new node is drafted in the record behind those that there are; :func:`insert` makes it one of them. In the signatures
``w`` is the workspace, ``s`` its record of the search's progress, ``e`` that of the expansion at hand, ``node`` the one
that is expanded and ``child`` the draft. What is done for each candidate takes records, and arrays only where it must:
numba counts references to each array that one function hands to another, and twenty of them cost as much as a foothold.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.motion import features
from legtool_runtime.motion.kernels import COM, VELOCITY, mean, mean_table, scale, scale_table
from legtool_runtime.motion.planning.clock import late
from legtool_runtime.motion.planning.costs import STRAYS, distance_at, miss, remaining
from legtool_runtime.motion.planning.problem import DistanceField, Models, Task
from legtool_runtime.motion.planning.workspace import NODE, NODE_BITS, Workspace, find, push
from legtool_runtime.robot import TROT_PAIRS

Array = NDArray[np.float64]

_PAIRS = np.array(TROT_PAIRS)
_V, _PV = features.VELOCITY.start, features.PREVIOUS_VELOCITY.start
_PR, _F = features.PREVIOUS_REFERENCE.start, features.FEET.start


@kernel
def expand(models: Models, field: DistanceField, task: Task, w: Workspace, n: int) -> None:
    """Open the nodes that lead on from node ``n``, as long as there is time."""
    s, e, node = w.progress[0], w.expansion[0], w.nodes[n]
    s.expanded += 1
    s.expanded_at[node.depth] += 1
    _describe(models, s, e, node)
    max_change = s.max_change if n == 0 else task.max_change
    count = _choose(models.commands, models.speeds, e, task.max_speed, max_change, w.candidates)
    e.monomials = mean_table(models.weights, e.features, e.pair, e.table)
    for k in range(count):
        if k & 63 == 63 and late(w.watch, task.deadline):  # a thousand commands take their time
            return
        c, child = w.candidates[k], w.nodes[s.nodes]
        mean(e.table, e.monomials, models.commands, c, e.pair, e.m, e.step)
        _advance(task, e, node, child)
        touchdown(task, field, e, node, child, 0)
        touchdown(task, field, e, node, child, 1)
        if task.misstep_cost > 0.0 and (_may_stray(e, 0) | _may_stray(e, 1)):
            if not e.scaled:
                scale_table(models.covariance, 0, e.features, e.pair, e.scale_table)
                e.scaled = 1
            risk(e, child)
        if not _safe(task, field.half_cell, s, e):
            continue
        stands = _stands(models.commands, c)
        cost = _cost(task, s, node, child, stands)
        if not cost < np.inf:  # a model far outside its data can predict anything
            continue
        key = _key(task, s, e, child, c, stands)
        slot = find(w.table, key, s.number)
        if _known(s.number, cost, slot, w.cost, w.table):
            continue
        w.table[slot, 0], child.slot, child.parent = key, slot, n
        _complete(e, node, child, models.commands, c)
        insert(s, child, cost, w.cost, w.heap, w.table)


@kernel
def _describe(models: Models, s: Any, e: Any, node: Any) -> None:
    """Begin an expansion: the pair that swings, how feet stray, a node's rotation and features."""
    e.depth, e.scaled = node.depth, 0
    e.pair = (s.swing_pair + node.depth) & 1
    for side in range(2):
        e.spread[side] = models.spread[node.depth, side]
        e.noise[side] = models.noise[side]
        e.reach[side] = STRAYS * np.sqrt(e.spread[side])
    cos, sin = np.cos(node.yaw), np.sin(node.yaw)
    for j in range(3):
        e.turned[0, j] = cos * s.rotation[0, j] - sin * s.rotation[1, j]
        e.turned[1, j] = sin * s.rotation[0, j] + cos * s.rotation[1, j]
        e.turned[2, j] = s.rotation[2, j]
    for i in range(3):
        e.features[_V + i] = node.velocity[i]
        e.features[_PV + i] = node.previous_velocity[i]
        e.features[_PR + i] = node.reference[i]
    for leg in range(4):  # equation 5
        for i in range(3):
            relative = 0.0
            for j in range(3):
                relative += e.turned[j, i] * (node.feet[leg, j] - node.position[j])
            e.features[_F + 3 * leg + i] = relative


@kernel
def _choose(
    commands: Array, speeds: Array, e: Any, max_speed: float, max_change: float, candidates: NDArray[np.int32]
) -> int:
    """Write the commands that may follow the last one; if none may, the one nearest to it. Their number."""
    before_x, before_y = e.features[_PR], e.features[_PR + 1]
    count, nearest, least = 0, 0, np.inf
    most = (max_change + 1e-9) ** 2
    for c in range(commands.shape[0]):
        change = (commands[c, 0] - before_x) ** 2 + (commands[c, 1] - before_y) ** 2
        candidates[count] = c
        count += (speeds[c] <= max_speed) & (change <= most)
        nearer = (speeds[c] <= max_speed) & (change < least)
        nearest, least = (c, change) if nearer else (nearest, least)
    if count == 0:
        candidates[0] = nearest
    return max(count, 1)


@kernel
def _advance(task: Task, e: Any, node: Any, child: Any) -> None:
    """Where the trunk gets to (equation 4), and how far feet that bear load roll meanwhile."""
    x, y, z = _moved(e, COM, node.position[0], node.position[1], node.position[2])
    e.roll[0], e.roll[1] = task.roll * (x - node.position[0]), task.roll * (y - node.position[1])
    child.position[0], child.position[1], child.position[2] = x, y, z
    child.yaw, child.depth = node.yaw + e.step[COM + 3], node.depth + 1


@kernel
def _moved(e: Any, begin: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A point after the displacement that begins at an output of the models."""
    turned = e.turned
    dx, dy, dz = e.step[begin], e.step[begin + 1], e.step[begin + 2]
    return (
        x + turned[0, 0] * dx + turned[0, 1] * dy + turned[0, 2] * dz,
        y + turned[1, 0] * dx + turned[1, 1] * dy + turned[1, 2] * dz,
        z + turned[2, 0] * dx + turned[2, 1] * dy + turned[2, 2] * dz,
    )


@kernel
def touchdown(task: Task, field: DistanceField, e: Any, node: Any, child: Any, side: int) -> None:
    """Where the front (0) or hind (1) swing foot comes down (equation 3), and how clear of unsafe cells."""
    leg = _PAIRS[e.pair, side]
    x, y, z = _moved(e, 3 * side, node.feet[leg, 0], node.feet[leg, 1], node.feet[leg, 2])
    landed = distance_at(field, x, y)
    clearance = min(landed, distance_at(field, x + e.roll[0], y + e.roll[1]))
    e.landed[side] = landed
    # From the cell's centre to the unsafe cell's edge.
    e.spare[side] = clearance - field.half_cell - task.margin
    child.feet[leg, 0], child.feet[leg, 1], child.feet[leg, 2] = x, y, z
    child.clearance[side], child.miss[side] = clearance, 0.0


@kernel
def _may_stray(e: Any, side: int) -> bool:
    """Whether a touchdown may stray beyond its margin."""
    return e.spare[side] < e.reach[side]


@kernel
def risk(e: Any, child: Any) -> None:
    """Probability of each touchdown that it strays beyond its margin to one side."""
    more = scale(e.scale_table, e.monomials, e.m) - 1.0
    for side in range(2):
        if _may_stray(e, side):
            child.miss[side] = miss(e.spare[side] / np.sqrt(e.spread[side] + more * e.noise[side]))


@kernel
def _safe(task: Task, half_cell: float, s: Any, e: Any) -> bool:
    """Whether both feet may come down there; for those that may not, that is counted."""
    safe = True
    for side in range(2):
        spare = e.landed[side] - half_cell if task.misstep_cost > 0.0 else e.spare[side]
        if not spare >= 0.0:
            s.rejected[e.depth, _PAIRS[e.pair, side]] += 1
            safe = False
    return safe


@kernel
def _cost(task: Task, s: Any, node: Any, child: Any, stands: bool) -> float:
    """f = d_goal + d_foot, and what waiting and missteps add [m]."""
    left = remaining(task, child.position[0], child.position[1], s.heading + child.yaw)
    child.waited = node.waited + (1 if stands and left > task.near else 0)
    d_foot, risked = 0.0, node.risk
    for side in range(2):
        if child.clearance[side] < task.d_max:
            d_foot += task.d_max - child.clearance[side]
        risked += task.misstep_cost * child.miss[side]
    child.risk = risked
    return left + d_foot + task.waiting_cost * child.waited + risked


@kernel
def _stands(commands: Array, c: int) -> bool:
    """Whether a command is to stand."""
    return (commands[c, 0] == 0.0) & (commands[c, 1] == 0.0) & (commands[c, 2] == 0.0)


@kernel
def insert(s: Any, child: Any, cost: float, costs: Array, heap: NDArray[np.int32], table: NDArray[np.int64]) -> None:
    """Make the drafted node one of the open ones."""
    costs[s.nodes] = cost
    table[child.slot, 1] = (s.number << NODE_BITS) | s.nodes
    push(heap, costs, s.open, s.nodes)
    if (child.depth > s.best_depth) | ((child.depth == s.best_depth) & (cost < costs[s.best])):
        s.best, s.best_depth = s.nodes, child.depth
    s.nodes += 1
    s.open += 1


@kernel
def _known(search: int, cost: float, slot: int, costs: Array, table: NDArray[np.int64]) -> bool:
    """Whether the node of a slot, if it is of this search, was visited or is no dearer."""
    other = table[slot, 1] & NODE
    return (table[slot, 1] >> NODE_BITS == search) & ((other == 0) | (cost >= costs[other]))


@kernel
def _key(task: Task, s: Any, e: Any, child: Any, command: int, stands: bool) -> int:
    """What a node shares with its duplicates."""
    key = np.int64(command)
    for axis in range(2):
        key = (key << 14) | ((int(np.floor(child.position[axis] / task.cell)) - s.cell[axis]) & 0x3FFF)
    key = (key << 10) | (int(np.floor(child.yaw / task.heading_bin + 0.5)) & 0x3FF)
    key = (key << 1) | (1 - e.pair)
    return (key << 6) | (child.depth if stands else 0)


@kernel
def _complete(e: Any, node: Any, child: Any, commands: Array, c: int) -> None:
    """What else a node holds: its command, velocities, and where the stance feet have rolled to."""
    for i in range(3):
        child.reference[i] = commands[c, i]
        child.velocity[i] = e.step[VELOCITY + i]
        child.previous_velocity[i] = node.velocity[i]
    for side in range(2):
        leg = _PAIRS[1 - e.pair, side]
        child.feet[leg, 0] = node.feet[leg, 0] + e.roll[0]
        child.feet[leg, 1] = node.feet[leg, 1] + e.roll[1]
        child.feet[leg, 2] = node.feet[leg, 2]
