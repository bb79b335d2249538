"""The search of the motion paper's Algorithm 1 in compiled code, over memory that is allocated once.

The start is node 0. A node is reached by a velocity command and stands for the full stance after that step. Open nodes
lie in a binary heap ordered by cost, equal costs by age. A hash table finds duplicates: same command, same CoM cell,
same pair to swing, same heading bin, and while standing the same depth, for each step of standing is a step of its own.
As in Algorithm 1 a duplicate of a visited node is dropped, and of an open one the cheaper stays.

Beyond the paper:

- A full sequence that makes no headway, in all or in its last step, is put aside, and comes back only if some more
  searching finds none that does. Else standing or dithering before an obstacle, always safe, would end each search
  before it had tried to step over.
- Where no first step within the bound on the command's change is safe, all commands are looked at.
- At most ``breadth`` nodes of a depth are expanded, the cheapest: the search ends in bounded time, and gets deep.
- What a step costs and risks: see :mod:`.expansion`.

Without a deadline the clock is not read, and the plan follows from the problem alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.motion.features import FEET, PREVIOUS_REFERENCE, PREVIOUS_VELOCITY, VELOCITY
from legtool_runtime.motion.planning.clock import late, watch_from_now
from legtool_runtime.motion.planning.costs import goal_distance, heading_error, remaining
from legtool_runtime.motion.planning.expansion import expand
from legtool_runtime.motion.planning.problem import DistanceField, Models, Start, Task
from legtool_runtime.motion.planning.workspace import NODE, NODE_BITS, Records, Workspace, pop, trace

REACHED_GOAL, REACHED_HORIZON, HALTED, OUT_OF_TIME, OUT_OF_NODES, GAVE_UP, NOTHING_OPEN = range(7)

Array = NDArray[np.float64]

_V, _PV, _PR, _F = VELOCITY.start, PREVIOUS_VELOCITY.start, PREVIOUS_REFERENCE.start, FEET.start


@kernel
def search(
    models: Models, start: Start, field: DistanceField, task: Task, w: Workspace, number: int
) -> tuple[int, int, int, int]:
    """Algorithm 1.

    Args:
        models: what the robot can do.
        start: where it is.
        field: where feet may stand.
        task: what is wanted.
        w: memory for as many commands and steps.
        number: of this search, different from that of every other one in the same workspace.

    Returns:
        why it ended, the length of the best sequence, which is then in ``w.path``, how many nodes were expanded, how
        many made.
    """
    s = w.progress[0]
    _begin(s, start, task, w.nodes[0])
    s.number, w.cost[0], w.heap[0] = number, 0.0, 0
    watch_from_now(w.watch, task.deadline)
    why, last = NOTHING_OPEN, 0
    while s.open > 0 or _reopen(s, w.heap):
        n = _take(s, w.nodes, w.cost, w.heap, w.table)
        if n < 0:
            continue
        node = w.nodes[n]
        if _arrived(task, s, node):
            why, last = REACHED_GOAL, n
            break
        whole = node.depth == task.horizon
        if whole and _goes_on(task, s, w.nodes, n):
            why, last = REACHED_HORIZON, n
            break
        if whole and s.halted == 0:
            s.halted, s.enough = n, s.expanded + task.insist
        if s.halted > 0 and s.expanded >= s.enough:
            break
        if whole:
            continue
        if late(w.watch, task.deadline):
            why = OUT_OF_TIME
            break
        if s.nodes + models.commands.shape[0] > w.nodes.shape[0]:
            why = OUT_OF_NODES
            break
        if s.expanded_at[node.depth] >= task.breadth:
            s.cut = 1
            continue
        expand(models, field, task, w, n)
    if why not in (REACHED_GOAL, REACHED_HORIZON):
        why, last = _settle_for(s, why)
    return why, trace(start.swing_pair, last, w), s.expanded, s.nodes


@kernel
def _begin(s: Any, start: Start, task: Task, node: Any) -> None:
    """Set a search's progress and its first node, which alone is open, to the start."""
    position, rotation, features, s.swing_pair = start
    node.yaw, node.risk = 0.0, 0.0
    node.depth, node.waited, node.parent, node.slot = 0, 0, -1, -1
    for i in range(3):
        node.position[i] = position[i]
        node.velocity[i] = features[_V + i]
        node.previous_velocity[i] = features[_PV + i]
        node.reference[i] = features[_PR + i]
        for j in range(3):
            s.rotation[i, j] = rotation[i, j]
    for leg in range(4):
        for i in range(3):
            at = position[i]
            for j in range(3):
                at += rotation[i, j] * features[_F + 3 * leg + j]
            node.feet[leg, i] = at
    s.nodes, s.open = 1, 1
    s.expanded, s.best, s.best_depth, s.halted, s.enough, s.cut = 0, 0, 0, 0, 0, 0
    for depth in range(task.horizon + 1):
        s.expanded_at[depth] = 0
        for leg in range(4):
            s.rejected[depth, leg] = 0
    s.max_change = task.max_change
    s.heading = np.arctan2(rotation[1, 0], rotation[0, 0])
    s.remaining = remaining(task, position[0], position[1], s.heading)
    for axis in range(2):
        s.cell[axis] = int(np.floor(position[axis] / task.cell))


@kernel
def _reopen(s: Any, heap: NDArray[np.int32]) -> bool:
    """Open the start once more where no first step was safe: to look beyond the bound on the command's change."""
    if s.nodes > 1 or s.max_change == np.inf:
        return False
    heap[0], s.open, s.expanded_at[0], s.max_change = 0, 1, 0, np.inf
    return True


@kernel
def _take(s: Any, nodes: Records, cost: Array, heap: NDArray[np.int32], table: NDArray[np.int64]) -> int:
    """The cheapest open node, which is visited now; -1 if a cheaper duplicate had taken its place."""
    n = pop(heap, cost, s.open)
    s.open -= 1
    slot = nodes[n].slot
    if n == 0:
        return 0
    if table[slot, 1] & NODE != n:
        return -1
    table[slot, 1] = s.number << NODE_BITS
    return n


@kernel
def _arrived(task: Task, s: Any, node: Any) -> bool:
    """Whether a node reaches the goal, given the search's progress ``s``."""
    x, y = node.position[0], node.position[1]
    if goal_distance(task, x, y) > task.goal_tolerance:
        return False
    return heading_error(task, x, y, s.heading + node.yaw) <= task.heading_tolerance


@kernel
def _goes_on(task: Task, s: Any, nodes: Records, n: int) -> bool:
    """Whether a full sequence makes headway, in all and in its last step, or has come near the goal on its way."""
    left = _left(task, s, nodes[n])
    ahead = _left(task, s, nodes[nodes[n].parent]) - left
    if ahead >= task.headway and s.remaining - left >= task.headway * task.horizon:
        return True
    while n > 0 and _left(task, s, nodes[n]) > task.near:
        n = nodes[n].parent
    return n > 0


@kernel
def _left(task: Task, s: Any, node: Any) -> float:
    """What remains from a node [m]."""
    return remaining(task, node.position[0], node.position[1], s.heading + node.yaw)


@kernel
def _settle_for(s: Any, why: int) -> tuple[int, int]:
    """What a search comes to that reached neither goal nor horizon, given its progress: why, and the last node."""
    if s.halted > 0:
        return HALTED, s.halted
    if why == NOTHING_OPEN and s.cut:
        return GAVE_UP, s.best
    return why, s.best
