"""The foothold search in compiled code: weighted A* over full stances and the phase of a gait (VI-C).

A stance is four candidates and a phase. A transition moves the feet of one swing set of the phase, each to a candidate
(its own one allowed), and leads to the next phase; the contact mode family between two stances is what they share.
Transitions are queued by what follows from the places of feet alone: reach (15), the signed dimensions of the stance
(16, 17), swing distance (18), support, and all of the cost. Kinematics and clearance are looked at when a transition
comes off the queue, those of a stance once. A stance is closed by the first valid transition that leads to it.

Most transitions lead away from the waypoint and would lie in the queue for good. A stance queues those whose f, by a
lower bound from the feet's mean alone, is within a slice, and itself with the least f of the rest (partial expansion
A*, Yoshizumi, Miura and Ishida 2000): the order stays that of A*.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.motion.planning.clock import late, watch_from_now
from legtool_runtime.motion.planning.workspace import NODE_BITS, find
from legtool_runtime.search.body import Body
from legtool_runtime.search.feet_checks import stance_of, walkable
from legtool_runtime.search.feet_memory import (
    CLOSED,
    INVALID,
    N_EXPANDED,
    N_HEAP,
    N_STANCES,
    OPEN,
    FeetMemory,
    dequeue,
    pack,
)
from legtool_runtime.search.feet_problem import PHASE, Gait, Task, World, places_of, pose_feet, to_go
from legtool_runtime.search.feet_transitions import expand
from legtool_runtime.search.field_kernels import Field
from legtool_runtime.search.stances import HEADING, Rules, shape_of

Doubles = NDArray[np.float64]

#: Why a search ended.
FOUND, NOTHING_OPEN, OUT_OF_TIME, OUT_OF_MEMORY = range(4)


@kernel
def search(
    world: World, body: Body, rules: Rules, gait: Gait, task: Task, field: Field, w: FeetMemory, number: int
) -> tuple[int, int, int]:
    """Search from the feet as they stand.

    Args:
        world: where feet may stand.
        body: of the robot.
        rules: of stances and transitions.
        gait: whose order is kept.
        task: what is wanted.
        field: cost to go of the torso, or none.
        w: memory.
        number: of this search, different from that of every other one in the same memory.

    Returns:
        why it ended; the number of stances of the path, which is then in ``w.path``, the start being the first; the
        stance it leads to.
    """
    w.counts[:], w.tally[:] = 0, 0
    stride, above = _longest_stride(gait, rules), body.height + body.radius
    root = _begin(world, body, rules, task, field, w, number, stride)
    watch_from_now(w.watch, task.deadline)
    why, last, best = NOTHING_OPEN, root, root
    if _arrived(task, w, root, above):
        return FOUND, _trace(w, root), root
    if not expand(world, body, rules, gait, task, field, w, root, task.weight * w.left[root], stride):
        why = OUT_OF_MEMORY
    while w.counts[N_HEAP] > 0 and why == NOTHING_OPEN:
        if late(w.watch, task.deadline) or w.counts[N_EXPANDED] >= task.most:
            why = OUT_OF_TIME
            break
        e = dequeue(w.queue)
        come, f = int(w.queue.come[e]), w.queue.f[e]
        n = -1 - come if come < 0 else stance_of(world, body, rules, w, w.queue.to[e], number)
        if n < 0:
            why = OUT_OF_MEMORY
            break
        if come >= 0:
            if w.state[n] != OPEN or not walkable(world, body, rules, w, come, n):
                continue
            w.state[n], w.parent[n], w.cost[n], w.depth[n] = CLOSED, come, w.queue.g[e], w.depth[come] + 1
            w.left[n] = to_go(task, rules.per_step_m, field, w.shape[n], above, stride)
            w.counts[N_EXPANDED] += 1
            if w.key[n] & PHASE == task.phase and w.left[n] < w.left[best]:
                best = n
            if w.key[n] & PHASE == task.phase and _arrived(task, w, n, above):
                why, last = FOUND, n
                break
        if not expand(world, body, rules, gait, task, field, w, n, f, stride):
            why = OUT_OF_MEMORY
    if why != FOUND:
        last = best if w.left[root] - w.left[best] >= task.progress else root
    return why, _trace(w, last), last


@kernel
def _longest_stride(gait: Gait, rules: Rules) -> float:
    """How far the torso moves in one transition at most: by a fourth of each swing [m]."""
    longest = 0
    for p in range(gait.sets.shape[0]):
        for k in range(gait.sets[p]):
            longest = max(longest, 1 if gait.legs[p, k, 1] < 0 else 2)
    return 0.25 * longest * rules.swing


@kernel
def far_from_all(points: Doubles, others: Doubles, near: float, level: float) -> NDArray[np.bool_]:
    """(n,) which points (n, 3) are not within a horizontal distance and a height of any other (k, 3)."""
    out = np.ones(points.shape[0], np.bool_)
    for c in range(points.shape[0]):
        for k in range(others.shape[0]):
            dx, dy = points[c, 0] - others[k, 0], points[c, 1] - others[k, 1]
            if dx * dx + dy * dy <= near * near and abs(points[c, 2] - others[k, 2]) <= level:
                out[c] = False
                break
    return out


@kernel
def _begin(
    world: World, body: Body, rules: Rules, task: Task, field: Field, w: FeetMemory, number: int, stride: float
) -> int:
    """Make the start the first stance. What it breaks is waived."""
    start = np.empty(4, np.int32)
    for leg in range(4):
        start[leg] = world.points.shape[0] - 4 + leg
    key = pack(start, task.phase)
    slot = find(w.table, key, number)
    w.table[slot, 0], w.table[slot, 1] = key, (number << NODE_BITS) | 0
    w.counts[N_STANCES] = 1
    w.pushed[0], w.left[0] = -np.inf, np.inf
    w.key[0], w.parent[0], w.state[0], w.cost[0], w.depth[0] = key, -1, CLOSED, 0.0, 0
    for leg in range(4):
        w.feet[0, leg] = start[leg]
    if shape_of(places_of(world, start, w.scratch.feet), rules.hips, w.shape[0]):
        pose_feet(body, w)
        w.pose[0] = w.scratch.pose
        w.left[0] = to_go(task, rules.per_step_m, field, w.shape[0], body.height + body.radius, stride)
    else:
        w.state[0] = INVALID
    return 0


@kernel
def _arrived(task: Task, w: FeetMemory, n: int, above: float) -> bool:
    shape = w.shape[n]
    dx, dy = task.goal[0] - shape[0], task.goal[1] - shape[1]
    dz = task.goal[2] - shape[2] - above
    if w.state[n] == INVALID or np.sqrt(dx * dx + dy * dy + dz * dz) > task.tolerance:
        return False
    if np.isnan(task.yaw):
        return True
    off = np.arctan2(shape[HEADING + 1], shape[HEADING]) - task.yaw
    return abs(off - 2.0 * np.pi * np.round(off / (2.0 * np.pi))) <= task.yaw_tolerance


@kernel
def _trace(w: FeetMemory, last: int) -> int:
    """Write the stances that lead to one, the start first; how many."""
    count = w.depth[last] + 1
    n = last
    for k in range(count - 1, -1, -1):
        if k < w.path.shape[0]:
            w.path[k] = n
        n = w.parent[n]
    return min(count, w.path.shape[0])
