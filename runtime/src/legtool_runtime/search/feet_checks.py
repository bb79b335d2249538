"""What of the foothold search is looked at when a transition comes off the queue: kinematics and clearance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.motion.planning.workspace import NODE, NODE_BITS, find
from legtool_runtime.search import stances
from legtool_runtime.search.body import Body, legs_fit, shanks_clear, trunk_clears
from legtool_runtime.search.feet_memory import INVALID, N_STANCES, N_VALIDATED, OPEN, FeetMemory, unpack
from legtool_runtime.search.feet_problem import World, places_of, pose_feet
from legtool_runtime.search.stances import Rules, shape_of
from legtool_runtime.tracking.ground import Ground, height_at, lowest_centre

Doubles = NDArray[np.float64]
Longs = NDArray[np.int64]

#: Swings are looked at every so many cells, with a foot that is so much wider [m], and must clear by so much [m].
_WIDER, _OVER = 0.02, 0.03
#: A swing rises where it begins and comes down where it ends: so near to an end nothing is higher than so much above
#: the higher one, nor than so much above this end; shares of the rule's apex.
_BESIDE, _RISEN, _RISER = 0.16, 0.20, 0.60


@kernel
def stance_of(world: World, body: Body, rules: Rules, w: FeetMemory, key: int, number: int) -> int:
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
    shape_of(places_of(world, w.feet[n], s.feet), rules.hips, w.shape[n])
    pose_feet(body, w)
    w.pose[n] = s.pose
    if w.feet[n].min() >= world.points.shape[0] - 4:  # the robot stands like that
        return n
    if rules.inverse_kinematics:
        if not legs_fit(body, np.ones(4, np.bool_), s):
            w.state[n] = INVALID
            w.tally[stances.KINEMATICS] += 1
        elif rules.shank >= 0.0 and not shanks_clear(body, world.ground, world.trunk, rules.shank, s):
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
def walkable(world: World, body: Body, rules: Rules, w: FeetMemory, a: int, b: int) -> bool:
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
                end = max(p[2], q[2])
                above = end + _RISEN * rules.apex
                near = min(above, p[2] + _RISER * rules.apex), min(above, q[2] + _RISER * rules.apex)
                limits = end + rules.apex - _OVER, near[0], near[1], _BESIDE * rules.apex
                if not _nothing_above(world.trunk, p, q, min(near)) and not _swing_clears(
                    world.ground, p, q, body.radius + _WIDER, limits
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
        pose_feet(body, w)
        return legs_fit(body, standing, s)
    standing[which] = True
    s.weights[which] = stances.SWING_WEIGHT
    fits = True
    for end in range(2):
        places_of(world, w.feet[b] if end else w.feet[a], s.feet)
        pose_feet(body, w)
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
def _swing_clears(
    ground: Ground, a: Doubles, b: Doubles, radius: float, limits: tuple[float, float, float, float]
) -> bool:
    """Whether nothing that is known within a radius of the straight way between two places is higher than the first
    limit, or than the second and the third one where the way is no farther than the fourth from its begin and end."""
    length = np.hypot(b[0] - a[0], b[1] - a[1])
    many = int(np.ceil(length / (2.0 * ground.cell)))
    for k in range(many + 1):
        share = k / max(many, 1)
        x, y = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
        most = limits[0]
        if share * length <= limits[3]:
            most = limits[1]
        if (1.0 - share) * length <= limits[3]:
            most = min(most, limits[2])
        if lowest_centre(ground, x, y, radius, False) > most:
            return False
    return True
