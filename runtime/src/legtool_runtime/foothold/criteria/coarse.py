"""A coarse count of the safe footholds over hip heights, in compiled code: the criteria at some cells and instants."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.foothold.criteria import dilation, leg_cycle, liftoff
from legtool_runtime.foothold.criteria.clearance import Tables
from legtool_runtime.foothold.criteria.gait_cycle import Cycle
from legtool_runtime.foothold.criteria.judge import hip_cell, sample_swing, smooth_cells, survey, tabulate
from legtool_runtime.foothold.criteria.rules import Rules

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Flags = NDArray[np.uint8]


class _View(NamedTuple):
    """What all hip heights share.

    ``places`` (3, >= ``found``) at which the foot may have stood, ``feet`` (3, m) candidates [m], ``paths`` and
    ``legs`` phases of the swing at which the foot's path and the leg are looked at, ``ground`` below the hip [m].
    """

    rules: Rules
    cycle: Cycle
    tables: Tables
    places: Array32
    found: int
    feet: Array32
    paths: Array32
    legs: Array32
    ground: float


@kernel
def count(h: Array32, rules: Rules, cycle: Cycle, hips: Array, out: Array32) -> None:
    """Write about how many cells of ``h`` (n, n) are safe for ascending hip heights ``hips`` (m,) [m] into ``out``.

    Every other cell is judged; those between are safe where their neighbours are. At every other hip height all of them
    are judged, at one between only those that are safe at one of its neighbours and not at the other.

    Args:
        h: heights [m].
        rules: the leg, and what it is judged by.
        cycle: the gait cycle.
        hips: of touchdown.
        out: (2, m) written: how many cells are safe, and how many of the judged ones before the erosion.
    """
    n, heights = h.shape[0], hips.shape[0]
    out[:] = 0
    filled, smooth, places, found = survey(h, rules, cycle)
    feet, cells = smooth_cells(h, smooth, rules.foot_radius, True)
    if cells.shape[0] == 0:
        return
    paths, legs = sample_swing(cycle, rules)
    if cycle.start < liftoff.LEAVING and found > 1:
        # How the leg lifts off was looked at when the place was chosen.
        legs = legs[1:].copy()
    tables = tabulate(filled, rules)
    view = _View(rules, cycle, tables, places, found, feet, paths, legs, h[hip_cell(cycle, n)])
    seems, clear = np.zeros((heights, cells.shape[0]), np.uint8), np.empty(cells.shape[0], np.uint8)
    lifts, last = np.full(heights, -1), -1
    for turn in range(2):
        for m in range(turn, heights, 2):
            if turn == 1 and m + 1 < heights and lifts[m - 1] == lifts[m + 1]:
                _judge_between(view, hips[m], lifts[m - 1], seems[m - 1], seems[m + 1], seems[m])
                continue
            lifts[m] = _judge(view, hips[m], last, clear, seems[m])
            last = lifts[m] if lifts[m] >= 0 else last
    # The cells between: safe by themselves, so that the erosion asks their neighbours.
    presumed, good, kept = smooth.copy(), np.empty((n, n), np.uint8), np.empty((n, n), np.uint8)
    presumed.reshape(-1)[cells] = 0
    flat = good.reshape(-1)
    for m in range(heights):
        seen = 0
        for k in range(cells.shape[0]):
            seen += seems[m, k]
        if seen > 0:
            out[1, m] = seen
            good[:] = presumed
            for k in range(cells.shape[0]):
                flat[np.uint32(cells[k])] = seems[m, k]
            out[0, m] = dilation.erode(good, rules.around, kept)


@kernel
def _judge(view: _View, hip_z: float, last: int, clear: Flags, seems: Flags) -> int:
    """Write which candidates seem safe with the hip at ``hip_z`` [m] into ``seems`` (m,).

    Args:
        view: what all hip heights share.
        hip_z: at touchdown [m].
        last: the place whose paths ``clear`` is of; -1 for none.
        clear: (m,) to which candidates the foot's path is clear, kept up.
        seems: written.

    Returns:
        the place from which the foot lifts off; -1 if the leg can from none, and nothing is safe.
    """
    rules = view.rules
    lift = -1
    # A hip below the ground has no leg to stand on.
    if hip_z > view.ground:
        lift = liftoff.choose_lift_off(rules, view.cycle, hip_z, view.places, view.found, view.tables)
    if lift < 0:
        return lift
    cycle = liftoff.lift_off_at(view.cycle, view.places, lift)
    margin, clearance = np.empty(seems.shape[0], np.float32), np.empty(seems.shape[0], np.float32)
    if lift != last:
        leg_cycle.clear_paths(cycle, view.feet, view.paths, view.tables, clearance)
        for k in range(clear.shape[0]):
            clear[k] = clearance[k] >= 0
    leg_cycle.move_leg(rules, cycle, hip_z, view.feet, view.legs, view.tables, True, margin, clearance)
    for k in range(seems.shape[0]):
        seems[k] = clear[k] & (margin[k] >= 0) & (clearance[k] >= 0)
    return lift


@kernel
def _judge_between(view: _View, hip_z: float, lift: int, lower: Flags, upper: Flags, seems: Flags) -> None:
    """Write into ``seems`` (m,) which candidates seem safe between two hip heights that lift off from place ``lift``.

    Those that are at both are here too; those that are at one are judged.
    """
    which, m = np.empty(seems.shape[0], np.int32), 0
    for k in range(seems.shape[0]):
        seems[k] = lower[k] & upper[k]
        which[m] = k
        m += lower[k] ^ upper[k]
    if m == 0:
        return
    rules = view.rules
    cycle = liftoff.lift_off_at(view.cycle, view.places, lift)
    feet, margin, clearance = np.empty((3, m), np.float32), np.empty(m, np.float32), np.empty(m, np.float32)
    for i in range(3):
        for j in range(m):
            feet[i, j] = view.feet[i, which[j]]
    leg_cycle.move_leg(rules, cycle, hip_z, feet, view.legs, view.tables, False, margin, clearance)
    for j in range(m):
        seems[which[j]] = (margin[j] >= 0) & (clearance[j] >= 0)
