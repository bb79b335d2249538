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

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.motion.planning.clock import late, watch_from_now
from legtool_runtime.motion.planning.workspace import NODE, NODE_BITS, find
from legtool_runtime.search import feet_memory as memory
from legtool_runtime.search import stances
from legtool_runtime.search.body import (
    TILT,
    Body,
    legs_fit,
    rotation_into,
    shanks_clear,
    trunk_clears,
)
from legtool_runtime.search.feet_memory import (
    CLOSED,
    INVALID,
    N_EXPANDED,
    N_HEAP,
    N_STANCES,
    N_VALIDATED,
    OPEN,
    FeetMemory,
    dequeue,
    enqueue,
    pack,
    unpack,
)
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
from legtool_runtime.tracking.ground import Ground, height_at, lowest_centre
from legtool_runtime.tracking.reach import level_pose

Doubles = NDArray[np.float64]
Longs = NDArray[np.int64]

#: Bits of a key that hold the phase.
PHASE = (1 << memory.PHASE_BITS) - 1
FOUND, NOTHING_OPEN, OUT_OF_TIME, OUT_OF_MEMORY = range(4)
#: Swings are looked at every so many cells, with a foot that is so much wider [m], and must clear by so much [m].
_WIDER, _OVER = 0.02, 0.03
#: A stance's transitions are queued up to its f + so much [m], less what such a share of the longest stride gains;
#: and farther each time again.
_SLICE, _STRIDE = 0.05, 0.75
#: The field at another heading within a turn may be less by so much [m].
_TURNED = 0.1
#: And so much less where a move is rounded [m].
_ROUNDED = 0.05


class World(NamedTuple):
    """What the search stands on: ``points`` (n, 3), of which the last four are the feet as they stand; ``price`` (n,)
    of setting a foot there [m]; ``place`` (n,) keys; the ground; ``refused``: sorted signatures of transitions."""

    points: Doubles
    price: Doubles
    place: Longs
    ground: Ground
    trunk: Ground
    refused: Longs


class Gait(NamedTuple):
    """``legs`` (phases, sets, 2) of each swing set, -1 for none; ``sets`` (phases,) their number."""

    legs: Longs
    sets: Longs


class Task(NamedTuple):
    """What is wanted: torso at ``goal`` (3,) within ``tolerance`` [m] and, unless NaN, heading ``yaw`` [rad] within
    ``yaw_tolerance``; starting with ``phase``; ``weight`` of the heuristic; ``progress`` that makes a partial path [m];
    ``most``: stances to be expanded."""

    goal: Doubles
    tolerance: float
    yaw: float
    yaw_tolerance: float
    phase: int
    weight: float
    progress: float
    deadline: int
    most: int


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
    if not _expand(world, body, rules, gait, task, field, w, root, task.weight * w.left[root], stride):
        why = OUT_OF_MEMORY
    while w.counts[N_HEAP] > 0 and why == NOTHING_OPEN:
        if late(w.watch, task.deadline) or w.counts[N_EXPANDED] >= task.most:
            why = OUT_OF_TIME
            break
        e = dequeue(w.queue)
        come, f = int(w.queue.come[e]), w.queue.f[e]
        n = -1 - come if come < 0 else _stance(world, body, rules, w, w.queue.to[e], number)
        if n < 0:
            why = OUT_OF_MEMORY
            break
        if come >= 0:
            if w.state[n] != OPEN or not _walkable(world, body, rules, w, come, n):
                continue
            w.state[n], w.parent[n], w.cost[n], w.depth[n] = CLOSED, come, w.queue.g[e], w.depth[come] + 1
            w.left[n] = _to_go(task, rules.per_step_m, field, w.shape[n], above, stride)
            w.counts[N_EXPANDED] += 1
            if w.key[n] & PHASE == task.phase and w.left[n] < w.left[best]:
                best = n
            if w.key[n] & PHASE == task.phase and _arrived(task, w, n, above):
                why, last = FOUND, n
                break
        if not _expand(world, body, rules, gait, task, field, w, n, f, stride):
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
    if shape_of(_places(world, start, w.scratch.feet), rules.hips, w.shape[0]):
        _pose(body, w)
        w.pose[0] = w.scratch.pose
        w.left[0] = _to_go(task, rules.per_step_m, field, w.shape[0], body.height + body.radius, stride)
    else:
        w.state[0] = INVALID
    return 0


@kernel
def _places(world: World, feet: NDArray[np.int32], out: Doubles) -> Doubles:
    for leg in range(4):
        for i in range(3):
            out[leg, i] = world.points[feet[leg], i]
    return out


@kernel
def _pose(body: Body, w: FeetMemory) -> None:
    """Make ``w.scratch``'s feet their centres and its pose the one that they imply, as the tracker's reference does."""
    s = w.scratch
    for leg in range(4):
        s.feet[leg, 2] += body.radius
    level_pose(s.feet, s.weights, body.height, TILT, s.pose)


@kernel
def _to_go(task: Task, per_step: float, field: Field, shape: Doubles, above: float, stride: float) -> float:
    """A lower bound of the cost to the waypoint: the straight way and its transitions, or what the field says."""
    dx, dy = task.goal[0] - shape[0], task.goal[1] - shape[1]
    dz = task.goal[2] - shape[2] - above
    far = max(np.sqrt(dx * dx + dy * dy + dz * dz) - task.tolerance, 0.0)
    if field.values.shape[0] > 1:
        far = max(far, cost_to_go(field, shape[0], shape[1], np.arctan2(shape[HEADING + 1], shape[HEADING])))
    return far + per_step * np.ceil(far / stride - 1e-9)


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
def _stance(world: World, body: Body, rules: Rules, w: FeetMemory, key: int, number: int) -> int:
    """The stance of a key, made and looked at if it is new; -1 where there is no room."""
    slot = find(w.table, key, number)
    if w.table[slot, 1] >> NODE_BITS == number:
        return int(w.table[slot, 1] & NODE)
    n = w.counts[N_STANCES]
    if n >= w.key.shape[0]:
        return -1
    w.counts[N_STANCES] = n + 1
    w.table[slot, 0], w.table[slot, 1] = key, (number << NODE_BITS) | n
    w.key[n], w.state[n], w.pushed[n] = key, OPEN, -np.inf
    unpack(key, w.feet[n])
    s = w.scratch
    shape_of(_places(world, w.feet[n], s.feet), rules.hips, w.shape[n])
    _pose(body, w)
    w.pose[n] = s.pose
    if w.feet[n].min() >= world.points.shape[0] - 4:  # the robot stands like that
        return n
    if rules.inverse_kinematics:
        if not legs_fit(body, np.ones(4, np.bool_), s):
            w.state[n] = INVALID
            w.tally[stances.KINEMATICS] += 1
        elif rules.shank >= 0.0 and not shanks_clear(body, world.ground, rules.shank, s):
            w.state[n] = INVALID
            w.tally[stances.SHANK] += 1
    if w.state[n] == OPEN and rules.trunk >= 0.0:
        place = (s.pose[0], s.pose[1], s.pose[2] - body.belly)
        if not trunk_clears(world.trunk, place, s.pose[5], body.half_length, rules.trunk):
            w.state[n] = INVALID
            w.tally[stances.TRUNK] += 1
    w.pose[n] = s.pose
    return n


@kernel
def move_signature(place: Longs, before: NDArray[np.int32], after: NDArray[np.int32]) -> int:
    """A number for which feet go from which places to which: the same in every frame."""
    total = np.uint64(0)
    for leg in range(4):
        if before[leg] != after[leg]:
            part = np.uint64(place[before[leg]]) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(leg)
            part = (part ^ (part >> np.uint64(29))) + np.uint64(place[after[leg]])
            part *= np.uint64(0xBF58476D1CE4E5B9)
            total += part ^ (part >> np.uint64(32))
    return int(np.int64(total))


@kernel
def _walkable(world: World, body: Body, rules: Rules, w: FeetMemory, a: int, b: int) -> bool:
    """Whether the way between two valid stances can be walked: poses on it, swings, and no refusal before."""
    w.counts[N_VALIDATED] += 1
    if world.refused.shape[0] > 0:
        signature = move_signature(world.place, w.feet[a], w.feet[b])
        k = np.searchsorted(world.refused, signature)
        if k < world.refused.shape[0] and world.refused[k] == signature:
            w.tally[stances.REFUSED] += 1
            return False
    if rules.inverse_kinematics and not _poses_fit(world, body, w, a, b):
        w.tally[stances.KINEMATICS] += 1
        return False
    if np.isfinite(rules.apex):
        for leg in range(4):
            if w.feet[a, leg] != w.feet[b, leg]:
                p, q = world.points[w.feet[a, leg]], world.points[w.feet[b, leg]]
                highest = max(p[2], q[2]) + rules.apex - _OVER
                if not _nothing_above(world.trunk, p, q, highest) and not _swing_clears(
                    world.ground, p, q, body.radius + _WIDER, highest
                ):
                    w.tally[stances.CORRIDOR] += 1
                    return False
    return True


@kernel
def _poses_fit(world: World, body: Body, w: FeetMemory, a: int, b: int) -> bool:
    """Whether legs reach on the way: those that bear half-way, where pairs swing; where one leg does, all at lift-off
    and touchdown, with the centre of mass moved off the swinging leg as the tracker moves it."""
    s, moved, which = w.scratch, 0, 0
    standing = np.ones(4, np.bool_)
    for leg in range(4):
        if w.feet[a, leg] != w.feet[b, leg]:
            standing[leg] = False
            moved, which = moved + 1, leg
    if moved == 0:
        return True
    if moved > 1:
        for leg in range(4):
            for i in range(3):
                s.feet[leg, i] = 0.5 * (world.points[w.feet[a, leg], i] + world.points[w.feet[b, leg], i])
        _pose(body, w)
        return legs_fit(body, standing, s)
    standing[which] = True
    s.weights[which] = stances.SWING_WEIGHT
    fits = True
    for end in range(2):
        _places(world, w.feet[b] if end else w.feet[a], s.feet)
        _pose(body, w)
        # A foot that the robot stands on already is reached, whatever the model says.
        waived = end == 0 and w.feet[a].min() >= world.points.shape[0] - 4
        fits = fits and (waived or legs_fit(body, standing, s))
    s.weights[which] = 1.0
    return fits


@kernel
def _nothing_above(trunk: Ground, a: Doubles, b: Doubles, highest: float) -> bool:
    """Whether all that is known within a trunk's half-width of the way between two places is low: a quick look."""
    many = int(np.ceil(np.hypot(b[0] - a[0], b[1] - a[1]) / (2.0 * trunk.cell))) + 1
    for k in range(many + 1):
        share = k / many
        if height_at(trunk, a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])) > highest:
            return False
    return True


@kernel
def _swing_clears(ground: Ground, a: Doubles, b: Doubles, radius: float, highest: float) -> bool:
    """Whether nothing that is known within a radius of the straight way between two places is higher."""
    length = np.hypot(b[0] - a[0], b[1] - a[1])
    many = int(np.ceil(length / (2.0 * ground.cell)))
    for k in range(many + 1):
        share = k / max(many, 1)
        x, y = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
        if lowest_centre(ground, x, y, radius, False) > highest:
            return False
    return True


@kernel
def _expand(
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
        worth = _price(world, rules, own, c) - gain * (w.aim[0] * dx + w.aim[1] * dy + w.aim[2] * dz)
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
        if _distance(world, c, w.feet[n, k]) < rules.apart - 1e-9:
            return False
    return True


@kernel
def _distance(world: World, a: int, b: int) -> float:
    dx, dy = world.points[a, 0] - world.points[b, 0], world.points[a, 1] - world.points[b, 1]
    dz = world.points[a, 2] - world.points[b, 2]
    return np.sqrt(dx * dx + dy * dy + dz * dz)


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
    g0 = w.cost[n] + rules.per_step_m
    least = g0 + task.weight * w.aim[3] - 1e-9
    if not single:
        _look_ahead(task, rules, field, w, n, stride)
    for i in range(many):
        a = w.lists[0, i]
        ax, ay, az = _moved(world, w.feet[n, first], a)
        price = g0 + _price(world, rules, w.feet[n, first], a)
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
                bx, by, bz = _moved(world, w.feet[n, second], b)
                x, y, z = x + bx, y + by, z + bz
                g += _price(world, rules, w.feet[n, second], b)
            f = max(f, _bound(task, rules, field, w, n, (0.25 * x, 0.25 * y, 0.25 * z), g, until, stride))
            if f > until:
                rest = min(rest, f)
            elif f > w.pushed[n] and not _queue(
                world, body, rules, task, field, w, which, (a, b, stays), (g, line, stride)
            ):
                return -np.inf
    return rest


@kernel
def _bound(
    task: Task, rules: Rules, field: Field, w: FeetMemory, n: int, move: tuple[float, float, float], g: float,
    until: float, stride: float,
) -> float:  # fmt: skip
    """A lower bound of f for a transition that moves the torso; a smaller one does where it is beyond the slice."""
    x, y, z = move
    single = w.ahead[0, 0] < 0.0
    by, f = memory.AHEAD / stride, 0.0
    if not single:
        f = g + w.ahead[int(np.round(x * by)) + memory.AHEAD, int(np.round(y * by)) + memory.AHEAD]
        if f > until:
            return f
    g += np.sqrt(x * x + y * y + z * z)
    dx, dy, dz = w.aim[0] * w.aim[4] - x, w.aim[1] * w.aim[4] - y, w.aim[2] * w.aim[4] - z
    far = max(np.sqrt(dx * dx + dy * dy + dz * dz) - task.tolerance, 0.0)
    f = max(f, g + task.weight * far)
    if f > until:
        return f
    if field.values.shape[0] > 1:
        yaw = w.scratch.point[2]
        far = max(far, cost_to_go(field, w.shape[n, 0] + x, w.shape[n, 1] + y, yaw) - _TURNED)
    return max(f, g + task.weight * (far + rules.per_step_m * np.ceil(far / stride - 1e-9)))


@kernel
def _queue(
    world: World, body: Body, rules: Rules, task: Task, field: Field, w: FeetMemory,
    which: tuple[int, int, int, int, int, int], to: tuple[int, int, bool], so_far: tuple[float, float, float],
) -> bool:  # fmt: skip
    """Queue a transition if the stance that it leads to keeps the cheap rules; False where there is no room."""
    n, first, second, following, _, _ = which
    a, b, stays = to
    g, line, stride = so_far
    single, stand = 1 if second < 0 else 0, world.points.shape[0] - 4
    feet, shape, old, p = w.next_feet, w.next_shape, w.next_old, w.scratch.feet
    for leg in range(4):
        feet[leg] = a if leg == first else (b if leg == second else w.feet[n, leg])
        old[leg] = feet[leg] >= stand
    _places(world, feet, p)
    fault = 0 if shape_of(p, rules.hips, shape) else stances.TILT
    if not fault and not stays:
        if not single and _distance(world, a, b) < rules.apart - 1e-9:
            fault = stances.APART
        else:
            fault = shape_fault(shape, rules, single, w.shape[0], old)
        if not fault:
            fault = _way_fault(rules, w, n, shape, single, first, p)
    if fault:
        w.tally[fault] += 1
        return True
    turn = turn_between(w.shape[n], shape) if rules.turn_m > 0.0 else 0.0
    g += move_cost(w.shape[n], shape, turn, rules, single) - rules.per_step_m
    if not single and not stays and 0.0 < rules.off_line < np.inf:
        g += rules.off_line_m * min(line / rules.off_line, 1.0) ** 2
    f = g + task.weight * _to_go(task, rules.per_step_m, field, shape, body.height + body.radius, stride)
    return enqueue(w.queue, f, g, pack(feet, following), n)


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
def _moved(world: World, a: int, b: int) -> tuple[float, float, float]:
    return (
        world.points[b, 0] - world.points[a, 0],
        world.points[b, 1] - world.points[a, 1],
        world.points[b, 2] - world.points[a, 2],
    )


@kernel
def _price(world: World, rules: Rules, a: int, b: int) -> float:
    """What a swing from one candidate to another costs, apart from the torso's way; nothing for one that stays."""
    if a == b:
        return 0.0
    return world.price[b] + 0.25 * rules.climb_m * abs(world.points[b, 2] - world.points[a, 2])


@kernel
def _way_fault(rules: Rules, w: FeetMemory, n: int, shape: Doubles, single: int, swings: int, p: Doubles) -> int:
    """Which rule the way to a stance with feet ``p`` (4, 3) breaks, by the places of feet alone."""
    cosine = shape[HEADING] * w.shape[n, HEADING] + shape[HEADING + 1] * w.shape[n, HEADING + 1]
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
                x, y = w.shape[n, MIDDLE], w.shape[n, MIDDLE + 1]
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
