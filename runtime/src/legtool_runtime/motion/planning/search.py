"""The search of the motion paper's Algorithm 1 in compiled code, over memory that is allocated once.

The start is node 0. A node is reached by a velocity command and stands for the full stance after that step. Open nodes
lie in a binary heap ordered by cost, equal costs by age. A hash table finds duplicates: same command, same CoM cell,
same pair to swing, same heading bin, and while standing the same depth, for each step of standing is a step of its own.
As in Algorithm 1 a duplicate of a visited node is dropped, and of an open one the cheaper stays.

Beyond the paper:

- A full sequence that makes no headway, in all or in its last step, is put aside, and comes back only if some more
  searching finds none that does. Else standing or dithering before an obstacle, always safe, would end each search
  before it had tried to step over.
- A foot rolls while it bears load: its centre moves by foot radius over standing height of what the trunk travels. A
  foothold is as far from an unsafe cell as the nearer of where the foot lands and where it will have rolled to, the
  coming step being taken to lead as far as this one.
- What a foothold risks stays with the sequence: the probability that the foot lands nearer than the margin to an unsafe
  cell, given the models' spread, adds to the cost of the node and of all that follow. So one search finds wide margins
  where there are any, and narrow ones where nothing else leads on.
- Where no first step within the bound on the command's change is safe, all commands are looked at.
- At most ``breadth`` nodes of a depth are expanded, the cheapest: the search ends in bounded time, and gets deep.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.motion.features import FEET, PREVIOUS_REFERENCE, PREVIOUS_VELOCITY, VELOCITY
from legtool_runtime.motion.kernels import predict_mean, predict_scale
from legtool_runtime.motion.planning.clock import now
from legtool_runtime.motion.planning.costs import STRAYS, distance_at, goal_distance, heading_error, miss, remaining
from legtool_runtime.motion.planning.workspace import NODE, NODE_BITS, Task, Terrain, Workspace, find, pop, push, trace
from legtool_runtime.robot import TROT_PAIRS

Array = NDArray[np.float64]

REACHED_GOAL, REACHED_HORIZON, HALTED, OUT_OF_TIME, OUT_OF_NODES, GAVE_UP, NOTHING_OPEN = range(7)

_PAIRS = np.array(TROT_PAIRS)
_V, _PV, _PR, _F = VELOCITY.start, PREVIOUS_VELOCITY.start, PREVIOUS_REFERENCE.start, FEET.start


@kernel
def _candidates(
    w: Workspace, commands: Array, speeds: Array, previous: Array, max_speed: float, max_change: float
) -> int:
    """Commands that may follow ``previous``; if none may, the one nearest to it. Written to the workspace."""
    count, nearest, least = 0, -1, np.inf
    most = (max_change + 1e-9) ** 2
    for c in range(commands.shape[0]):
        if speeds[c] > max_speed:
            continue
        change = (commands[c, 0] - previous[0]) ** 2 + (commands[c, 1] - previous[1]) ** 2
        if change <= most:
            w.candidates[count] = c
            for i in range(3):
                w.candidate[count, i] = commands[c, i]
            count += 1
        if change < least:
            nearest, least = c, change
    if count == 0:
        w.candidates[0] = nearest
        w.candidate[0] = commands[nearest]
        count = 1
    return count


@kernel
def search(
    weights: Array,
    covariance: Array,
    spread: Array,
    noise: Array,
    commands: Array,
    speeds: Array,
    rotation: Array,
    position: Array,
    state: Array,
    swing_pair: int,
    terrain: Terrain,
    task: Task,
    horizon: int,
    insist: int,
    breadth: int,
    deadline: int,
    number: int,
    w: Workspace,
) -> tuple[int, int, int, int]:
    """Algorithm 1.

    Args:
        weights, covariance: of the motion model, packed.
        spread, noise: (≥ horizon, 2) and (2,) of :func:`.uncertainty.touchdown_variance`.
        commands: (m, 3); speeds: (m,) their planar speed.
        rotation: (3, 3) base to world; position: (3,) CoM, world; state: (24,) features of the start.
        swing_pair: pair that swings first.
        insist: how many nodes to expand after the first sequence that halts, in search of one that does not.
        breadth: how many to expand at each depth.
        deadline: time of :data:`.clock.CLOCK` [ns].
        number: of this search, different from that of every other one in the same workspace.

    Returns:
        why it ended, the length of the best sequence, which is then in ``w.path``, how many nodes were expanded, how
        many made.
    """
    half_cell = 0.5 / terrain.cells_per_m
    heading0 = np.arctan2(rotation[1, 0], rotation[0, 0])
    cell_x0, cell_y0 = int(np.floor(position[0] / task.cell)), int(np.floor(position[1] / task.cell))
    w.rejected[:] = 0
    w.expanded[:] = 0
    w.position[0] = position
    w.yaw[0] = 0.0
    w.depth[0], w.waited[0], w.parent[0], w.command[0], w.slot[0] = 0, 0, -1, -1, -1
    w.cost[0], w.risk[0] = 0.0, 0.0
    for i in range(3):
        w.velocity[0, i] = state[_V + i]
        w.previous_velocity[0, i] = state[_PV + i]
    for leg in range(4):
        for i in range(3):
            w.feet[0, leg, i] = position[i]
            for j in range(3):
                w.feet[0, leg, i] += rotation[i, j] * state[_F + 3 * leg + j]
    w.heap[0] = 0
    nodes, open_nodes, expanded, best = 1, 1, 0, 0
    halted, more, cut = 0, 0, False
    at_start = remaining(task, position[0], position[1], heading0)
    turned = np.empty((3, 3))
    previous = state[_PR : _PR + 3].copy()
    touchdown = np.empty((2, 3))
    clearance, missed = np.empty(2), np.empty(2)
    max_change = task.max_change
    why, last = NOTHING_OPEN, 0
    # When the clock was last read, and the longest pause between two readings so far: another must not end too late.
    read, pause = now(w.timespec), 0
    while True:
        if open_nodes == 0:
            if nodes > 1 or max_change == np.inf:
                break
            w.heap[0], open_nodes, w.expanded[0] = 0, 1, 0  # no first step is safe: look beyond the bound
            max_change = np.inf
        n = pop(w.heap, w.cost, open_nodes)
        open_nodes -= 1
        if n > 0:
            if w.table[w.slot[n], 1] & NODE != n:
                continue  # a cheaper duplicate took its place
            w.table[w.slot[n], 1] = number << NODE_BITS  # visited
        depth = w.depth[n]
        heading = heading0 + w.yaw[n]
        if (
            goal_distance(task, w.position[n, 0], w.position[n, 1]) <= task.goal_tolerance
            and heading_error(task, w.position[n, 0], w.position[n, 1], heading) <= task.heading_tolerance
        ):
            why, last = REACHED_GOAL, n
            break
        if depth == horizon:
            before = w.parent[n]
            left = remaining(task, w.position[n, 0], w.position[n, 1], heading)
            ahead = remaining(task, w.position[before, 0], w.position[before, 1], heading0 + w.yaw[before]) - left
            goes_on = ahead >= task.headway and at_start - left >= task.headway * horizon
            along = n
            while along > 0 and not goes_on:  # a sequence that has come near the goal on its way has arrived
                near = remaining(task, w.position[along, 0], w.position[along, 1], heading0 + w.yaw[along])
                goes_on = near <= task.near
                along = w.parent[along]
            if goes_on:
                why, last = REACHED_HORIZON, n
                break
            if halted == 0:
                halted, more = n, expanded + insist
            if expanded >= more:
                break
            continue
        time = now(w.timespec)
        pause, read = max(pause, time - read), time
        if time + pause >= deadline:
            why = OUT_OF_TIME
            break
        if nodes + commands.shape[0] > w.cost.shape[0]:
            why = OUT_OF_NODES
            break
        if halted > 0 and expanded >= more:
            break
        if w.expanded[depth] >= breadth:
            cut = True
            continue
        w.expanded[depth] += 1
        expanded += 1
        pair = (swing_pair + depth) & 1
        c, s = np.cos(w.yaw[n]), np.sin(w.yaw[n])
        for j in range(3):
            turned[0, j] = c * rotation[0, j] - s * rotation[1, j]
            turned[1, j] = s * rotation[0, j] + c * rotation[1, j]
            turned[2, j] = rotation[2, j]
        if n > 0:
            previous[:] = commands[w.command[n]]
        for i in range(3):
            w.features[_V + i] = w.velocity[n, i]
            w.features[_PV + i] = w.previous_velocity[n, i]
            w.features[_PR + i] = previous[i]
        for leg in range(4):  # equation 5
            for i in range(3):
                relative = 0.0
                for j in range(3):
                    relative += turned[j, i] * (w.feet[n, leg, j] - w.position[n, j])
                w.features[_F + 3 * leg + i] = relative
        count = _candidates(w, commands, speeds, previous, task.max_speed, max_change if n == 0 else task.max_change)
        candidate = w.candidate[:count]
        predict_mean(
            weights, w.features, pair, candidate, w.step_feet[:count], w.step_com[:count], w.step_velocity[:count]
        )
        scaled = False
        for k in range(count):
            if k & 63 == 63:  # a thousand commands take their time
                time = now(w.timespec)
                pause, read = max(pause, time - read), time
                if time + pause >= deadline:
                    break
            x, y, z = w.position[n, 0], w.position[n, 1], w.position[n, 2]
            for j in range(3):  # equation 4
                x += turned[0, j] * w.step_com[k, j]
                y += turned[1, j] * w.step_com[k, j]
                z += turned[2, j] * w.step_com[k, j]
            roll_x, roll_y = task.roll * (x - w.position[n, 0]), task.roll * (y - w.position[n, 1])
            d_foot, risk, safe = 0.0, w.risk[n], True
            for side in range(2):
                leg = _PAIRS[pair, side]
                for i in range(3):  # equation 3
                    touchdown[side, i] = w.feet[n, leg, i]
                    for j in range(3):
                        touchdown[side, i] += turned[i, j] * w.step_feet[k, leg, j]
                landed = distance_at(terrain, touchdown[side, 0], touchdown[side, 1])
                distance = min(landed, distance_at(terrain, touchdown[side, 0] + roll_x, touchdown[side, 1] + roll_y))
                spare = distance - half_cell - task.margin  # from the cell's centre to the unsafe cell's edge
                clearance[side], missed[side] = distance, 0.0
                if task.misstep_cost > 0.0:
                    if spare < STRAYS * np.sqrt(spread[depth, side]):
                        if not scaled:
                            predict_scale(covariance, w.features, pair, candidate, w.step_scale[:count])
                            scaled = True
                        variance = spread[depth, side] + (w.step_scale[k, 0] - 1.0) * noise[side]
                        missed[side] = miss(spare / np.sqrt(variance))
                        risk += task.misstep_cost * missed[side]
                    spare = landed - half_cell
                if not spare >= 0.0:
                    w.rejected[depth, leg] += 1
                    safe = False
                if distance < task.d_max:
                    d_foot += task.d_max - distance
            if not safe:
                continue
            yaw = w.yaw[n] + w.step_com[k, 3]
            stands = candidate[k, 0] == 0.0 and candidate[k, 1] == 0.0 and candidate[k, 2] == 0.0
            left = remaining(task, x, y, heading0 + yaw)
            waited = w.waited[n] + (1 if stands and left > task.near else 0)
            cost = left + d_foot + task.waiting_cost * waited + risk
            if not cost < np.inf:
                continue  # a model far outside its data can predict anything
            key = np.int64(w.candidates[k])
            key = (key << 14) | ((int(np.floor(x / task.cell)) - cell_x0) & 0x3FFF)
            key = (key << 14) | ((int(np.floor(y / task.cell)) - cell_y0) & 0x3FFF)
            key = (key << 10) | (int(np.floor(yaw / task.heading_bin + 0.5)) & 0x3FF)
            key = (key << 1) | (1 - pair)
            key = (key << 6) | (depth + 1 if stands else 0)
            slot = find(w.table, key, number)
            if w.table[slot, 1] >> NODE_BITS == number:
                other = w.table[slot, 1] & NODE
                if other == 0 or cost >= w.cost[other]:
                    continue
            child = nodes
            nodes += 1
            w.table[slot, 0], w.table[slot, 1], w.slot[child] = key, (number << NODE_BITS) | child, slot
            w.position[child, 0], w.position[child, 1], w.position[child, 2] = x, y, z
            w.yaw[child], w.cost[child] = yaw, cost
            w.command[child], w.parent[child] = w.candidates[k], n
            w.depth[child], w.waited[child], w.risk[child] = depth + 1, waited, risk
            for i in range(3):
                w.velocity[child, i] = w.step_velocity[k, i]
                w.previous_velocity[child, i] = w.velocity[n, i]
            for leg in range(4):
                w.feet[child, leg, 0] = w.feet[n, leg, 0] + roll_x
                w.feet[child, leg, 1] = w.feet[n, leg, 1] + roll_y
                w.feet[child, leg, 2] = w.feet[n, leg, 2]
            for side in range(2):
                for i in range(3):
                    w.feet[child, _PAIRS[pair, side], i] = touchdown[side, i]
                w.clearance[child, side], w.miss[child, side] = clearance[side], missed[side]
            push(w.heap, w.cost, open_nodes, child)
            open_nodes += 1
            if w.depth[child] > w.depth[best] or (w.depth[child] == w.depth[best] and cost < w.cost[best]):
                best = child
    if why not in (REACHED_GOAL, REACHED_HORIZON):
        if halted > 0:
            why, last = HALTED, halted
        else:
            last = best
            if why == NOTHING_OPEN and cut:
                why = GAVE_UP
    return why, trace(commands, swing_pair, last, w), expanded, nodes
