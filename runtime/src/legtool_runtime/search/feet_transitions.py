"""The transitions of a stance, queued by what follows from the places of feet alone, slice by slice of f."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.search import feet_memory as memory
from legtool_runtime.search import stances
from legtool_runtime.search.body import Body, rotation_into
from legtool_runtime.search.feet_memory import INVALID, FeetMemory, enqueue, pack
from legtool_runtime.search.feet_problem import PHASE, Gait, Task, World, distance, moved, price_of, to_go
from legtool_runtime.search.field_kernels import Field, cost_to_go
from legtool_runtime.search.stances import (
    HEADING,
    MIDDLE,
    Rules,
    in_reach,
    least_share,
    move_cost,
    shape_fault,
    shape_of,
    turn_between,
)

Doubles = NDArray[np.float64]

#: A stance's transitions are queued up to its f + so much [m], less what such a share of the longest stride gains;
#: and farther each time again.
_SLICE, _STRIDE = 0.05, 0.75
#: The field at another heading within a turn may be less by so much [m].
_TURNED = 0.04
#: And so much less where a move is rounded [m].
_ROUNDED = 0.05


@kernel
def expand(
    world: World, body: Body, rules: Rules, gait: Gait, task: Task, field: Field, w: FeetMemory, n: int, f: float,
    stride: float,
) -> bool:  # fmt: skip
    """Queue the transitions of a stance whose f is next, and what is left of it; False where there is no room."""
    phase = int(w.key[n] & PHASE)
    following = (phase + 1) % gait.sets.shape[0]
    if w.state[n] == INVALID:
        return True
    rotation_into(w.pose[n], w.scratch.rotation)
    if w.pushed[n] == -np.inf:
        until = f + _SLICE - _STRIDE * (task.weight - 1.0) * stride
    else:
        until = f + 2.0 * max(f - w.pushed[n], 0.0) + 2.0 * _SLICE
    rest = np.inf
    _aim(task, body, w, n)
    w.ahead[0, 0] = -1.0  # none, for single legs
    for k in range(gait.sets[phase]):
        first, second = gait.legs[phase, k, 0], gait.legs[phase, k, 1]
        limit = _bearing(world, rules, w, n, first, second)
        many = _list(world, body, rules, w, n, first, second, task.weight)
        others = _list(world, body, rules, w, n, second, first, -task.weight) if second >= 0 else 1
        which = (n, first, second, following, many, others)
        left = _pairs(world, body, rules, task, field, w, which, (limit[0], limit[1], until, stride))
        if left == -np.inf:
            return False
        rest = min(rest, left)
    w.pushed[n] = until
    return rest == np.inf or enqueue(w.queue, rest, w.cost[n], w.key[n], -1 - n)


@kernel
def _bearing(world: World, rules: Rules, w: FeetMemory, n: int, first: int, second: int) -> tuple[float, float]:
    """δ of a torso that does not move, signed, and the limit of |δ|; writes the line's normal to
    ``w.scratch.point``."""
    if second < 0 or not np.isfinite(rules.off_line):
        return 0.0, np.inf
    a, b, old = -1, -1, False
    for leg in range(4):
        if leg not in (first, second):
            a, b = b, leg
            old = old or w.feet[n, leg] >= world.points.shape[0] - 4
    p, q = world.points[w.feet[n, a]], world.points[w.feet[n, b]]
    ux, uy = q[0] - p[0], q[1] - p[1]
    length = max(np.hypot(ux, uy), 1e-9)
    w.scratch.point[0], w.scratch.point[1] = -uy / length, ux / length
    off = w.scratch.point[0] * (w.shape[n, 0] - p[0]) + w.scratch.point[1] * (w.shape[n, 1] - p[1])
    return off, max(rules.off_line, abs(off)) if old else rules.off_line


@kernel
def _list(world: World, body: Body, rules: Rules, w: FeetMemory, n: int, leg: int, other: int, weight: float) -> int:
    """Write the candidates that a leg may swing to, its own too, with their shares in δ and by their worth; to the
    second row for a negative weight. How many.

    The distance to the waypoint is at least what is left of it along the straight way, which is linear in the feet: a
    foot that goes by Δ changes f by its price less (weight - 1) · the way along Δ / 4, or by more.
    """
    row = 0 if weight > 0.0 else 1
    gain = 0.25 * (abs(weight) - 1.0)
    own, count = w.feet[n, leg], 1
    w.worth[row, 0] = 0.0
    base = w.shape[n, 2] + body.height + body.radius
    w.lists[row, 0], w.shares[row, 0] = own, 0.0
    px, py, pz = world.points[own, 0], world.points[own, 1], world.points[own, 2]
    nx, ny = w.scratch.point[0], w.scratch.point[1]
    far = rules.swing * rules.swing * (1.0 + 1e-9)
    for c in range(world.points.shape[0] - 4):
        dx, dy = world.points[c, 0] - px, world.points[c, 1] - py
        square = dx * dx + dy * dy
        if square > far or c == own:
            continue
        dz = world.points[c, 2] - pz
        if square + dz * dz > far or dz > rules.swing_up + 1e-9 or dz < -rules.swing_down - 1e-9:
            w.tally[stances.SWING] += 1
            continue
        if not in_reach(
            rules, leg, w.pose[n], w.scratch.rotation, base, world.points[c, 0], world.points[c, 1], world.points[c, 2]
        ):
            w.tally[stances.REACH] += 1
            continue
        if not _apart(world, rules, w, n, c, leg, other):
            w.tally[stances.APART] += 1
            continue
        worth = price_of(world, rules, own, c) - gain * (w.aim[0] * dx + w.aim[1] * dy + w.aim[2] * dz)
        k = count
        while k > 0 and worth < w.worth[row, k - 1]:
            w.lists[row, k], w.shares[row, k] = w.lists[row, k - 1], w.shares[row, k - 1]
            w.worth[row, k] = w.worth[row, k - 1]
            k -= 1
        w.lists[row, k], w.shares[row, k], w.worth[row, k] = c, 0.125 * (nx * dx + ny * dy), worth
        count += 1
    return count


@kernel
def _aim(task: Task, body: Body, w: FeetMemory, n: int) -> None:
    """Write the direction from a stance's torso to the waypoint and the distance, beyond the tolerance."""
    w.aim[0], w.aim[1] = task.goal[0] - w.shape[n, 0], task.goal[1] - w.shape[n, 1]
    w.aim[2] = task.goal[2] - w.shape[n, 2] - body.height - body.radius
    far = np.sqrt(w.aim[0] ** 2 + w.aim[1] ** 2 + w.aim[2] ** 2)
    for i in range(3):
        w.aim[i] /= max(far, 1e-9)
    w.aim[3], w.aim[4] = far - task.tolerance, far


@kernel
def _apart(world: World, rules: Rules, w: FeetMemory, n: int, c: int, leg: int, other: int) -> bool:
    """Whether a candidate is far enough from the feet that stay."""
    for k in range(4):
        if k in (leg, other):
            continue
        if distance(world, c, w.feet[n, k]) < rules.apart - 1e-9:
            return False
    return True


@kernel
def _pairs(
    world: World, body: Body, rules: Rules, task: Task, field: Field, w: FeetMemory,
    which: tuple[int, int, int, int, int, int], limit: tuple[float, float, float, float],
) -> float:  # fmt: skip
    """Queue the transitions of one swing set whose f lies in the slice up to ``limit[2]``: combinations of its legs'
    candidates that keep the cheap rules. The least f of those beyond; -inf where there is no room."""
    n, first, second, _, many, others = which
    off, most, until, stride = limit
    rest, single, pairs = np.inf, second < 0, np.isfinite(most)
    w.scratch.point[2] = np.arctan2(w.shape[n, HEADING + 1], w.shape[n, HEADING])
    above = body.height + body.radius
    here_x, here_y, yaw = w.shape[n, 0], w.shape[n, 1], w.scratch.point[2]
    g0 = w.cost[n] + rules.per_step_m
    least = g0 + task.weight * w.aim[3] - 1e-9
    if not single:
        _look_ahead(task, rules, field, w, n, stride)
    for i in range(many):
        a = w.lists[0, i]
        ax, ay, az = moved(world, w.feet[n, first], a)
        price = g0 + price_of(world, rules, w.feet[n, first], a)
        for j in range(others):
            f = least + w.worth[0, i] + (0.0 if single else w.worth[1, j])
            if f > until:  # and so for all that follow
                rest = min(rest, f)
                break
            b = w.lists[1, j] if not single else -1
            line = abs(off + w.shares[0, i] + w.shares[1, j]) if pairs else 0.0
            stays = a == w.feet[n, first] and (single or b == w.feet[n, second])
            if line > most + 1e-9 and not stays:
                continue
            x, y, z, g = ax, ay, az, price
            if not single:
                bx, by, bz = moved(world, w.feet[n, second], b)
                x, y, z = x + bx, y + by, z + bz
                g += price_of(world, rules, w.feet[n, second], b)
            move = (0.25 * x, 0.25 * y, 0.25 * z)
            f = max(
                f,
                _bound(
                    w.ahead,
                    w.aim,
                    field,
                    (here_x, here_y, yaw),
                    move,
                    (g, until, task.weight, task.tolerance, rules.per_step_m, stride),
                ),
            )
            if f > until:
                rest = min(rest, f)
            elif f > w.pushed[n] and not _queue(
                world.points, rules, task, field, w.queue, w.hand,
                (w.feet[n], w.shape[n], w.shape[0]), (n, first, second, which[3]), (a, b, stays),
                (g, line, stride, above),
            ):  # fmt: skip
                return -np.inf
    return rest


@kernel
def _bound(
    ahead: Doubles,
    aim: Doubles,
    field: Field,
    here: tuple[float, float, float],
    move: tuple[float, float, float],
    costs: tuple[float, float, float, float, float, float],
) -> float:
    """A lower bound of f for a transition that moves the torso; a smaller one does where it is beyond the slice.

    It is called for each pair of footholds, and takes no more than it needs: what is handed on costs time.
    """
    x, y, z = move
    g, until, weight, tolerance, per_step, stride = costs
    f = 0.0
    if ahead[0, 0] >= 0.0:
        by = memory.AHEAD / stride
        f = g + ahead[int(np.round(x * by)) + memory.AHEAD, int(np.round(y * by)) + memory.AHEAD]
        if f > until:
            return f
    g += np.sqrt(x * x + y * y + z * z)
    dx, dy, dz = aim[0] * aim[4] - x, aim[1] * aim[4] - y, aim[2] * aim[4] - z
    far = max(np.sqrt(dx * dx + dy * dy + dz * dz) - tolerance, 0.0)
    f = max(f, g + weight * far)
    if f > until:
        return f
    if field.values.shape[0] > 1:
        far = max(far, cost_to_go(field, here[0] + x, here[1] + y, here[2]) - _TURNED)
    return max(f, g + weight * (far + per_step * np.ceil(far / stride - 1e-9)))


@kernel
def _queue(
    points: Doubles,
    rules: Rules,
    task: Task,
    field: Field,
    queue: memory.Queue,
    hand: memory.Hand,
    stance: tuple[NDArray[np.int32], Doubles, Doubles],
    which: tuple[int, int, int, int],
    to: tuple[int, int, bool],
    so_far: tuple[float, float, float, float],
) -> bool:
    """Queue a transition if the stance that it leads to keeps the cheap rules; False where there is no room."""
    now, before, start = stance
    n, first, second, following = which
    a, b, stays = to
    g, line, stride, above = so_far
    single, p, shape = 1 if second < 0 else 0, hand.places, hand.shape
    for leg in range(4):
        c = a if leg == first else (b if leg == second else now[leg])
        hand.feet[leg], hand.old[leg] = c, c >= points.shape[0] - 4
        for i in range(3):
            p[leg, i] = points[c, i]
    fault = 0 if shape_of(p, rules.hips, shape) else stances.TILT
    if not fault and not stays:
        dx, dy, dz = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]
        if not single and np.sqrt(dx * dx + dy * dy + dz * dz) < rules.apart - 1e-9:
            fault = stances.APART
        else:
            fault = shape_fault(shape, rules, single, start, hand.old)
        if not fault:
            fault = _way_fault(rules, before, shape, single, first, p)
    if fault:
        hand.tally[fault] += 1
        return True
    turn = turn_between(before, shape) if rules.turn_m > 0.0 else 0.0
    g += move_cost(before, shape, turn, rules, single) - rules.per_step_m
    if not single and not stays and 0.0 < rules.off_line < np.inf:
        g += rules.off_line_m * min(line / rules.off_line, 1.0) ** 2
    f = g + task.weight * to_go(task, rules.per_step_m, field, shape, above, stride)
    return enqueue(queue, f, g, pack(hand.feet, following), n)


@kernel
def _look_ahead(task: Task, rules: Rules, field: Field, w: FeetMemory, n: int, stride: float) -> None:
    """Write what the torso's way and the cost to go after it add to f at least, by its rounded horizontal move."""
    step = stride / memory.AHEAD
    off, yaw = 0.71 * step, w.scratch.point[2]
    for i in range(2 * memory.AHEAD + 1):
        x = (i - memory.AHEAD) * step
        for j in range(2 * memory.AHEAD + 1):
            y = (j - memory.AHEAD) * step
            dx, dy = task.goal[0] - w.shape[n, 0] - x, task.goal[1] - w.shape[n, 1] - y
            far = np.sqrt(dx * dx + dy * dy) - task.tolerance - off
            if field.values.shape[0] > 1:
                far = max(far, cost_to_go(field, w.shape[n, 0] + x, w.shape[n, 1] + y, yaw) - _TURNED - _ROUNDED)
            far = max(far, 0.0)
            far += rules.per_step_m * np.ceil(far / stride - 1e-9)
            w.ahead[i, j] = max(np.sqrt(x * x + y * y) - off, 0.0) + task.weight * far


@kernel
def _way_fault(rules: Rules, before: Doubles, shape: Doubles, single: int, swings: int, p: Doubles) -> int:
    """Which rule the way to a stance with feet ``p`` (4, 3) breaks, by the places of feet alone."""
    cosine = shape[HEADING] * before[HEADING] + shape[HEADING + 1] * before[HEADING + 1]
    if rules.turn < 1.5 and cosine < np.cos(rules.turn) - 1e-9:
        return stances.TURN
    if single and rules.support > 0.0:
        # The centre of mass over the middle of the feet, the swinging one counting less, at lift-off and touchdown.
        bear = 3.0 + stances.SWING_WEIGHT
        for end in range(2):
            if end:
                x, y = shape[MIDDLE], shape[MIDDLE + 1]
                mx, my = p[swings, 0], p[swings, 1]
            else:
                x, y = before[MIDDLE], before[MIDDLE + 1]
                mx, my = 4.0 * x, 4.0 * y
                for leg in range(4):
                    if leg != swings:
                        mx -= p[leg, 0]
                        my -= p[leg, 1]
            x = (4.0 * x - (1.0 - stances.SWING_WEIGHT) * mx) / bear
            y = (4.0 * y - (1.0 - stances.SWING_WEIGHT) * my) / bear
            if least_share(p, swings, x, y) < rules.support:
                return stances.SUPPORT
    return 0
