"""Where the foot lifts off, in compiled code: ViTAL's tuple says only about where, by step length and travel.

The foot has stood there, and the foothold was chosen by these criteria: so it is the nearest place with smooth terrain
all over the uncertainty radius from which the leg can lift off, within its limits and clear of the terrain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.foothold.criteria.clearance import Tables, clear_leg
from legtool_runtime.foothold.criteria.gait_cycle import Cycle, swing_weights
from legtool_runtime.foothold.criteria.leg import bend_leg, reach_foot
from legtool_runtime.foothold.criteria.rules import Rules
from legtool_runtime.foothold.settings import RESOLUTION_M

Array32 = NDArray[np.float32]
Flags = NDArray[np.uint8]

#: Places within this radius are looked at, in cells: at most so many.
RADIUS, PLACES = 8, 220
#: Until this share of the swing what the leg does depends little on where it goes; it is looked at so often until then.
LEAVING, LOOKS = 0.4, 5
#: Places that are looked at together: mostly the nearest will do.
_BLOCK = 16


@kernel
def lift_off_places(
    cycle: Cycle, filled: Array32, smooth: Flags, around: NDArray[np.int32], foot_radius: float, out: Array32
) -> int:
    """Write where the foot may have stood into ``out`` (3, PLACES): foot centres [m], nearest first; returns how many.

    With no such place around, or off the map, it is the cycle's lift-off point itself; the ground off the map is as
    high as the map's edge.
    """
    n = filled.shape[0]
    half = n // 2
    u, v = cycle.lift_x / RESOLUTION_M + half, cycle.lift_y / RESOLUTION_M + half
    i, j = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
    inside = 0 <= i < n and 0 <= j < n
    cells, distances = np.empty((PLACES, 2), np.int64), np.empty(PLACES)
    count = 0
    if inside:
        for p in range(max(i - RADIUS, 0), min(i + RADIUS + 1, n)):
            for q in range(max(j - RADIUS, 0), min(j + RADIUS + 1, n)):
                distance = (p - u) ** 2 + (q - v) ** 2
                if distance >= RADIUS**2:
                    continue
                good = True
                for k in range(around.shape[0]):
                    p2, q2 = p + around[k, 0], q + around[k, 1]
                    if not (0 <= p2 < n and 0 <= q2 < n) or not smooth[p2, q2]:
                        good = False
                        break
                if good:
                    cells[count, 0], cells[count, 1] = p, q
                    # Rounded, so that ties are told by the order of the cells.
                    distances[count] = np.floor(distance * 1e6 + 0.5)
                    count += 1
    if count == 0:
        ground = filled[min(max(i, 0), n - 1), min(max(j, 0), n - 1)]
        out[0, 0], out[1, 0], out[2, 0] = cycle.lift_x, cycle.lift_y, ground + foot_radius
        return 1
    order = np.argsort(distances[:count], kind="mergesort")
    for k in range(count):
        p, q = cells[order[k], 0], cells[order[k], 1]
        out[0, k], out[1, k] = (p - half) * RESOLUTION_M, (q - half) * RESOLUTION_M
        out[2, k] = filled[p, q] + foot_radius
    return count


@kernel
def choose_lift_off(rules: Rules, cycle: Cycle, hip_z: float, places: Array32, count: int, tables: Tables) -> int:
    """The first of ``count`` ``places`` from which the leg can lift off with the hip at ``hip_z``; -1 if none is.

    It can if it keeps its limits and stays clear of the terrain on the first part of a level swing to the nominal
    foothold.
    """
    if cycle.start >= LEAVING or count == 1:
        return 0
    work, index = np.empty((15, _BLOCK), np.float32), np.empty(_BLOCK, np.int32)
    near, order = min(count, _BLOCK), np.arange(count)
    first = first_lift_off(rules, cycle, hip_z, places, order[:near], tables, work, index)
    if first >= 0 or near == count:
        return first
    # Mostly one of the nearest will do. If not, those are left that are within reach at both ends of what is looked at.
    feet, margin = np.empty((3, count), np.float32), np.full(count, np.float32(1.0))
    for phase in (cycle.start, LEAVING):
        raise_feet(cycle, places, phase, feet)
        reach_foot(rules.leg, cycle, hip_z, (phase - 1.0) * cycle.swing_s, feet, margin)
    left = near
    for j in range(near, count):
        order[left] = j
        left += margin[j] >= 0
    for k in range(near, left, _BLOCK):
        some = order[k : min(k + _BLOCK, left)]
        first = first_lift_off(rules, cycle, hip_z, places, some, tables, work, index)
        if first >= 0:
            return some[first]
    return -1


@kernel
def raise_feet(cycle: Cycle, places: Array32, phase: float, feet: Array32) -> None:
    """Write where the feet (3, n) are at a phase of level swings from ``places`` (3, >= n) to the nominal foothold."""
    w = np.empty(4, np.float32)
    swing_weights(phase, w)
    across, rise = w[0], np.float32(w[3] * cycle.height)
    aim_x, aim_y = np.float32(cycle.aim_x), np.float32(cycle.aim_y)
    for j in range(feet.shape[1]):
        feet[0, j] = places[0, j] + (aim_x - places[0, j]) * across
    for j in range(feet.shape[1]):
        feet[1, j] = places[1, j] + (aim_y - places[1, j]) * across
    for j in range(feet.shape[1]):
        feet[2, j] = places[2, j] + rise


@kernel
def first_lift_off(
    rules: Rules,
    cycle: Cycle,
    hip_z: float,
    places: Array32,
    some: NDArray[np.int64],
    tables: Tables,
    work: Array32,
    index: NDArray[np.int32],
) -> int:
    """Which of ``some`` (m,) of the places, at most ``_BLOCK``, is the first to lift off from; -1 if none is.

    ``work`` (15, _BLOCK) and ``index`` (_BLOCK,) are to work in; else as :func:`choose_lift_off`.
    """
    part, feet, links = work[0:3], work[3:6], work[6:12]
    margin, least, below = work[12], work[13], work[14]
    for i in range(3):
        for j in range(_BLOCK):
            part[i, j] = places[i, some[min(j, some.shape[0] - 1)]]
    margin[:] = np.float32(1.0)
    least[:] = np.float32(1e3)
    for k in range(LOOKS):
        phase = cycle.start + (LEAVING - cycle.start) * k / (LOOKS - 1)
        raise_feet(cycle, part, phase, feet)
        bend_leg(rules.leg, cycle, hip_z, (phase - 1.0) * cycle.swing_s, feet, links, margin)
        if margin.max() < 0:
            break
        clear_leg(rules.points, links, feet, tables, index, below, least)
        if least.max() < 0:
            break
    for j in range(some.shape[0]):
        if margin[j] >= 0 and least[j] >= 0:
            return j
    return -1


@kernel
def lift_off_at(cycle: Cycle, places: Array32, chosen: int) -> Cycle:
    """The cycle from the chosen of the places on, from the nearest if none will do."""
    k = max(chosen, 0)
    return Cycle(
        cycle.hip_x, cycle.hip_y, cycle.velocity_x, cycle.velocity_y, cycle.velocity_z, cycle.yaw_rate,
        float(places[0, k]), float(places[1, k]), float(places[2, k]), cycle.aim_x, cycle.aim_y,
        cycle.swing_s, cycle.stance_s, cycle.start, cycle.height, cycle.roll, cycle.pitch,
    )  # fmt: skip
