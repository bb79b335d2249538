"""The steps that lead on from a node: where the feet come down, what that risks and costs, which nodes are new.

- A foot rolls while it bears load: its centre moves by foot radius over standing height of what the trunk travels. A
  foothold is as far from an unsafe cell as the nearer of where the foot lands and where it will have rolled to, the
  coming step being taken to lead as far as this one.
- What a foothold risks stays with the sequence: the probability that the foot lands nearer than the margin to an unsafe
  cell, given the models' spread, adds to the cost of the node and of all that follow. So one search finds wide margins
  where there are any, and narrow ones where nothing else leads on.

A new node is drafted in the record behind those that there are; :func:`insert` makes it one of them. What is done for
each candidate takes records and few arrays: each array that compiled functions hand on is counted, in and out.
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
    _describe(s, e, node, models.spread)
    if n > 0:
        _follow(e, models.commands, node.command)
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
            risk(e, child, models.noise)
        if _safe(task, field.cells_per_m, s, e):
            stands = _stands(models.commands, c)
            cost = _cost(task, s, node, child, stands)
            # A model far outside its data can predict anything.
            if cost < np.inf and insert(s, child, cost, _key(task, s, e, child, c, stands), w.cost, w.heap, w.table):
                child.command, child.parent = c, n
                _complete(e, node, child)


@kernel
def _describe(s: Any, e: Any, node: Any, spread: Array) -> None:
    """Begin an expansion: the pair that swings, a node's rotation and features, the coming reference left out."""
    e.depth, e.scaled = node.depth, 0
    e.pair = (s.swing_pair + node.depth) & 1
    for side in range(2):
        e.spread[side] = spread[node.depth, side]
    cos, sin = np.cos(node.yaw), np.sin(node.yaw)
    for j in range(3):
        e.turned[0, j] = cos * s.rotation[0, j] - sin * s.rotation[1, j]
        e.turned[1, j] = sin * s.rotation[0, j] + cos * s.rotation[1, j]
        e.turned[2, j] = s.rotation[2, j]
    for i in range(3):
        e.features[_V + i] = node.velocity[i]
        e.features[_PV + i] = node.previous_velocity[i]
        e.features[_PR + i] = s.reference[i]
    for leg in range(4):  # equation 5
        for i in range(3):
            relative = 0.0
            for j in range(3):
                relative += e.turned[j, i] * (node.feet[leg, j] - node.position[j])
            e.features[_F + 3 * leg + i] = relative


@kernel
def _follow(e: Any, commands: Array, c: int) -> None:
    for i in range(3):
        e.features[_PR + i] = commands[c, i]


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
    for i in range(3):
        at = node.position[i]
        for j in range(3):
            at += e.turned[i, j] * e.step[COM + j]
        child.position[i] = at
    child.yaw, child.depth = node.yaw + e.step[COM + 3], node.depth + 1
    for axis in range(2):
        e.roll[axis] = task.roll * (child.position[axis] - node.position[axis])


@kernel
def touchdown(task: Task, field: DistanceField, e: Any, node: Any, child: Any, side: int) -> None:
    """Where the front (0) or hind (1) swing foot comes down (equation 3), and how clear of unsafe cells."""
    leg = _PAIRS[e.pair, side]
    for i in range(3):
        at = node.feet[leg, i]
        for j in range(3):
            at += e.turned[i, j] * e.step[3 * side + j]
        child.feet[leg, i] = at
    x, y = child.feet[leg, 0], child.feet[leg, 1]
    e.landed[side] = distance_at(field, x, y)
    child.clearance[side] = min(e.landed[side], distance_at(field, x + e.roll[0], y + e.roll[1]))
    child.miss[side] = 0.0
    # From the cell's centre to the unsafe cell's edge.
    e.spare[side] = child.clearance[side] - 0.5 / field.cells_per_m - task.margin


@kernel
def _may_stray(e: Any, side: int) -> bool:
    """Whether a touchdown may stray beyond its margin."""
    return e.spare[side] < STRAYS * np.sqrt(e.spread[side])


@kernel
def risk(e: Any, child: Any, noise: Array) -> None:
    """Probability of each touchdown that it strays beyond its margin to one side."""
    more = scale(e.scale_table, e.monomials, e.m) - 1.0
    for side in range(2):
        if _may_stray(e, side):
            child.miss[side] = miss(e.spare[side] / np.sqrt(e.spread[side] + more * noise[side]))


@kernel
def _safe(task: Task, cells_per_m: float, s: Any, e: Any) -> bool:
    """Whether both feet may come down there; for those that may not, that is counted."""
    safe = True
    for side in range(2):
        spare = e.landed[side] - 0.5 / cells_per_m if task.misstep_cost > 0.0 else e.spare[side]
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
def insert(
    s: Any, child: Any, cost: float, key: int, costs: Array, heap: NDArray[np.int32], table: NDArray[np.int64]
) -> bool:
    """Open the drafted node; False, and nothing done, if a duplicate was visited or is no dearer."""
    new, slot = s.nodes, find(table, key, s.number)
    other = table[slot, 1] & NODE
    if (table[slot, 1] >> NODE_BITS == s.number) & ((other == 0) | (cost >= costs[other])):
        return False
    table[slot, 0], table[slot, 1], child.slot = key, (s.number << NODE_BITS) | new, slot
    costs[new] = cost
    push(heap, costs, s.open, new)
    s.nodes += 1
    s.open += 1
    if (child.depth > s.best_depth) | ((child.depth == s.best_depth) & (cost < costs[s.best])):
        s.best, s.best_depth = new, child.depth
    return True


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
def _complete(e: Any, node: Any, child: Any) -> None:
    """What else a node holds: velocities, and where the stance feet have rolled to."""
    for i in range(3):
        child.velocity[i] = e.step[VELOCITY + i]
        child.previous_velocity[i] = node.velocity[i]
    for side in range(2):
        leg = _PAIRS[1 - e.pair, side]
        child.feet[leg, 0] = node.feet[leg, 0] + e.roll[0]
        child.feet[leg, 1] = node.feet[leg, 1] + e.roll[1]
        child.feet[leg, 2] = node.feet[leg, 2]
