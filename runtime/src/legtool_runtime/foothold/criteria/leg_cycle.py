"""The criteria of one leg over one gait cycle, in compiled code: many candidate footholds at once.

The cycle is sampled: the swing from lift-off to each candidate, touchdown, and the stance to the next lift-off, while
the hip moves with the base twist.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.foothold.criteria.clearance import Tables, clear_leg, clear_points, lowest
from legtool_runtime.foothold.criteria.gait_cycle import Cycle, place_swing
from legtool_runtime.foothold.criteria.leg import bend_leg, reach_foot
from legtool_runtime.foothold.criteria.rules import Rules

Array32 = NDArray[np.float32]

#: Candidates that are taken together: what they need stays in the first-level cache.
CHUNK = 448
#: Numbers in the widest vector.
_VECTOR = 16


@kernel
def clear_paths(cycle: Cycle, candidates: Array32, phases: Array32, tables: Tables, clearance: Array32) -> None:
    """Write the least clearance (n,) of the foot on its swings to ``candidates`` (3, n)."""
    n = clearance.shape[0]
    foot, below, index = np.empty((3, CHUNK), np.float32), np.empty(CHUNK, np.float32), np.empty(CHUNK, np.int32)
    part, least = np.empty((3, CHUNK), np.float32), np.empty(CHUNK, np.float32)
    for first in range(0, n, CHUNK):
        m = min(CHUNK, n - first)
        part[:, :m] = candidates[:, first : first + m]
        part[:, m:] = np.float32(1e3)
        least[:] = np.float32(1e3)
        for k in range(phases.shape[0]):
            place_swing(cycle, phases[k], part, foot)
            if lowest(foot[2]) < tables.thin_top:
                clear_points(foot, foot, 0.0, tables.thin, tables.thin_grid, index, below, least)
        clearance[first : first + m] = least[:m]


@kernel
def move_leg(
    rules: Rules,
    cycle: Cycle,
    hip_z: float,
    candidates: Array32,
    phases: Array32,
    tables: Tables,
    hurry: bool,
    margin: Array32,
    clearance: Array32,
) -> None:
    """Write the least kinematic margin (n,) and the leg's least clearance (n,) [m] over the cycle of each candidate.

    Args:
        rules: the leg, the points along it, and at how many instants its stance is looked at.
        cycle: the gait cycle, from the place of lift-off.
        hip_z: height of the hip at touchdown [m].
        candidates: (3, n) foot centres at touchdown [m].
        phases: of the swing, touchdown left out.
        tables: of the terrain.
        hurry: give up on candidates that fail: of margin and clearance one is then below zero, the other unknown.
        margin: written.
        clearance: written.
    """
    leg, points, stances = rules.leg, rules.points, rules.instants[2]
    n = candidates.shape[1]
    place, left = np.empty(n, np.int32), n
    margin[:], clearance[:] = np.float32(1.0), np.float32(1e3)
    if hurry:
        reach_foot(leg, cycle, hip_z, 0.0, candidates, margin)
        reach_foot(leg, cycle, hip_z, cycle.stance_s, candidates, margin)
        left = 0
        for j in range(n):
            place[left] = j
            left += margin[j] >= 0
    else:
        place[:] = np.arange(n)
    for first in range(0, left, CHUNK):
        m = min(CHUNK, left - first)
        here = place[first : first + m]
        some, reach, least = _take(candidates, here)
        foot, bent, below, index = _room(some.shape[1])
        for k in range(phases.shape[0] + stances):
            if k < stances:
                tau = cycle.stance_s * k / (stances - 1)
                bend_leg(leg, cycle, hip_z, tau, some, bent, reach)
                end = some
            else:
                phase = phases[k - stances]
                place_swing(cycle, phase, some, foot)
                bend_leg(leg, cycle, hip_z, (phase - 1.0) * cycle.swing_s, foot, bent, reach)
                end = foot
            clear_leg(points, bent, end, tables, index, below, least)
            if not hurry:
                continue
            alive = 0
            for j in range(m):
                alive += (reach[j] >= 0) & (least[j] >= 0)
            if alive == 0:
                break
            if 2 * alive < m:
                # With most of them settled, go on with the others alone.
                _note(here, reach, least, margin, clearance)
                m = 0
                for j in range(here.shape[0]):
                    here[m] = here[j]
                    m += (reach[j] >= 0) & (least[j] >= 0)
                here = here[:m]
                some, reach, least = _take(candidates, here)
                foot, bent, below, index = _room(some.shape[1])
        _note(here, reach, least, margin, clearance)


@kernel
def _note(some: NDArray[np.int32], reach: Array32, least: Array32, margin: Array32, clearance: Array32) -> None:
    """Lower the margin and clearance (n,) of the candidates with numbers ``some`` (m,) to what was found of late."""
    for j in range(some.shape[0]):
        k = some[j]
        margin[k], clearance[k] = min(reach[j], margin[k]), min(least[j], clearance[k])


@kernel
def _take(candidates: Array32, some: NDArray[np.int32]) -> tuple[Array32, Array32, Array32]:
    """The candidates (3, n) with numbers ``some`` (m,), as wide as whole vectors are, and room for what is found."""
    m = some.shape[0]
    width = (m + _VECTOR - 1) // _VECTOR * _VECTOR
    taken = np.empty((3, width), np.float32)
    for i in range(3):
        for j in range(m):
            taken[i, j] = candidates[i, some[j]]
        taken[i, m:] = taken[i, 0]
    return taken, np.full(width, np.float32(1.0)), np.full(width, np.float32(1e3))


@kernel
def _room(width: int) -> tuple[Array32, Array32, Array32, NDArray[np.int32]]:
    """Room to work in for so many feet."""
    foot, bent = np.empty((3, width), np.float32), np.empty((6, width), np.float32)
    return foot, bent, np.empty(width, np.float32), np.empty(width, np.int32)
