"""All criteria of one heightmap together, in compiled code: for one hip height, and counted over many."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.foothold.criteria import dilation, leg_cycle, liftoff
from legtool_runtime.foothold.criteria.clearance import CellGrid, Tables
from legtool_runtime.foothold.criteria.gait_cycle import Cycle, swing_phases
from legtool_runtime.foothold.criteria.rules import Rules
from legtool_runtime.foothold.settings import RESOLUTION_M

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Flags = NDArray[np.uint8]

#: Bits that say why a cell is unsafe.
TR, LC, KF, FC, UNKNOWN, MARGIN = 1, 2, 4, 8, 16, 32


@kernel
def table_grid(n: int, fineness: int) -> CellGrid:
    """Where the table of an (n, n) map lies."""
    fine = RESOLUTION_M / fineness
    return CellGrid(-0.5 * n * RESOLUTION_M - fine, fine, n * fineness + 2)


@kernel
def tabulate(filled: Array32, rules: Rules) -> Tables:
    """Heights ``filled`` (n, n) dilated by the balls of foot and leg."""
    thin, thick = rules.thin, rules.thick
    n = filled.shape[0]
    thin_grid, thick_grid = table_grid(n, thin[2]), table_grid(n, thick[2])
    thin_table = np.empty((thin_grid.cells, thin_grid.cells), np.float32)
    thick_table = np.empty((thick_grid.cells, thick_grid.cells), np.float32)
    thin_top = dilation.dilate(filled, thin[0], thin[1], thin[2], thin_table)
    thick_top = dilation.dilate(filled, thick[0], thick[1], thick[2], thick_table)
    return Tables(thin_table, thin_grid, thin_top, thick_table, thick_grid, thick_top)


@kernel
def sample_swing(cycle: Cycle, rules: Rules) -> tuple[Array32, Array32]:
    """Phases of the swing at which the foot's path is judged, and at which the leg is, touchdown left out."""
    paths, legs = np.empty(rules.instants[0], np.float32), np.empty(rules.instants[1] + 1, np.float32)
    swing_phases(cycle.start, rules.contact, 1.0 - rules.contact, paths)
    swing_phases(cycle.start, 0.0, 1.0, legs)
    return paths, legs[: rules.instants[1]].copy()


@kernel
def survey(h: Array32, rules: Rules, cycle: Cycle) -> tuple[Array32, Flags, Array32, int]:
    """What all hip heights share of ``h`` (n, n), of which some cell is known.

    Returns:
        heights without unknown cells, where TR holds, and the places (3, PLACES) at which the foot may have stood, and
        how many these are; 0 if no cell of ``h`` is known.
    """
    n = h.shape[0]
    filled, smooth = np.empty((n, n), np.float32), np.zeros((n, n), np.uint8)
    places, found = np.empty((3, liftoff.PLACES), np.float32), 0
    if dilation.fill(h, filled):
        dilation.smooth(h, RESOLUTION_M, rules.slopes[0], rules.slopes[1], smooth)
        found = liftoff.lift_off_places(cycle, filled, smooth, rules.around, rules.foot_radius, places)
    return filled, smooth, places, found


@kernel
def evaluate(
    h: Array32, rules: Rules, cycle: Cycle, hip_z: float, box: tuple[int, int, int, int], reasons: Flags
) -> None:
    """Write why each cell of ``h`` (n, n) is unsafe into ``reasons`` (n, n).

    Args:
        h: heights [m].
        rules: the leg, and what it is judged by.
        cycle: the gait cycle.
        hip_z: height of the hip at touchdown [m].
        box: first and last + 1 cell in x, then y: only these are judged, the others left unsafe.
        reasons: written.
    """
    n = h.shape[0]
    reasons[:] = UNKNOWN
    filled, smooth, places, found = survey(h, rules, cycle)
    if found == 0:
        return
    tables = tabulate(filled, rules)
    chosen = liftoff.choose_lift_off(rules, cycle, hip_z, places, found, tables)
    cycle = liftoff.lift_off_at(cycle, places, chosen)
    candidates, count = np.empty((3, n * n), np.float32), 0
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            if h[i, j] == h[i, j]:
                place(i, j, n, h[i, j] + np.float32(rules.foot_radius), candidates, count)
                count += 1
    xyz = candidates[:, :count].copy()
    path_phases, leg_phases = sample_swing(cycle, rules)
    path_clearance = np.empty(count, np.float32)
    leg_cycle.clear_paths(cycle, xyz, path_phases, tables, path_clearance)
    margin, clearance = np.empty(count, np.float32), np.empty(count, np.float32)
    leg_cycle.move_leg(rules, cycle, hip_z, xyz, leg_phases, tables, False, margin, clearance)
    safe = np.zeros((n, n), np.uint8)
    k = 0
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            bits = 0 if smooth[i, j] else TR
            if h[i, j] == h[i, j]:
                bits += 0 if clearance[k] >= 0 else LC
                bits += 0 if margin[k] >= 0 else KF
                bits += 0 if path_clearance[k] >= 0 else FC
                k += 1
            else:
                bits += UNKNOWN
            reasons[i, j] = bits
            safe[i, j] = bits == 0
    kept = np.empty((n, n), np.uint8)
    dilation.erode(safe, rules.around, kept)
    for i in range(n):
        for j in range(n):
            if safe[i, j] and not kept[i, j]:
                reasons[i, j] = MARGIN


@kernel
def lift_off(h: Array32, rules: Rules, cycle: Cycle, hip_z: float, out: Array) -> None:
    """Write the foot's centre at lift-off (3,) [m], as :func:`evaluate` takes it."""
    filled, _, places, found = survey(h, rules, cycle)
    chosen = 0
    if found == 0:
        places[0, 0], places[1, 0], places[2, 0] = cycle.lift_x, cycle.lift_y, rules.foot_radius
    elif cycle.start < liftoff.LEAVING and found > 1:
        tables = tabulate(filled, rules)
        chosen = max(liftoff.choose_lift_off(rules, cycle, hip_z, places, found, tables), 0)
    for k in range(3):
        out[k] = places[k, chosen]


@kernel
def count(h: Array32, rules: Rules, cycle: Cycle, hips: Array, out: NDArray[np.int64], safe: Flags) -> None:
    """Write the number of safe cells into ``out`` (m,) for hip heights ``hips`` (m,) [m]; else as :func:`evaluate`.

    Tables, roughness and candidates serve all hip heights, the paths of the foot all that share a lift-off. Into
    ``safe`` (n, n) it writes which cells are safe for the last of the hip heights.
    """
    n = h.shape[0]
    out[:], safe[:] = 0, 0
    filled, smooth, places, found = survey(h, rules, cycle)
    if found == 0:
        return
    tables = tabulate(filled, rules)
    xyz, cells = smooth_cells(h, smooth, rules.foot_radius, False)
    left = cells.shape[0]
    path_phases, leg_phases = sample_swing(cycle, rules)
    path_clearance = np.empty(left, np.float32)
    good, good_cells, kept = np.empty((3, 0), np.float32), np.empty(left, np.int32), 0
    margin, clearance = np.empty(left, np.float32), np.empty(left, np.float32)
    good_here = np.empty((n, n), np.uint8)
    flat = good_here.reshape(-1)
    # A hip below the ground has no leg to stand on.
    ground = h[hip_cell(cycle, n)]
    last = -2
    for m in range(hips.shape[0]):
        safe[:] = 0
        if hips[m] <= ground:
            continue
        chosen = liftoff.choose_lift_off(rules, cycle, hips[m], places, found, tables)
        if rules.coarse and chosen < 0:
            continue
        moved = liftoff.lift_off_at(cycle, places, chosen)
        if chosen != last:
            leg_cycle.clear_paths(moved, xyz, path_phases, tables, path_clearance)
            good, kept = np.empty((3, left), np.float32), 0
            for k in range(left):
                if path_clearance[k] >= 0:
                    good[:, kept] = xyz[:, k]
                    good_cells[kept] = cells[k]
                    kept += 1
            good = good[:, :kept].copy()
            last = chosen
        leg_cycle.move_leg(rules, moved, hips[m], good, leg_phases, tables, True, margin[:kept], clearance[:kept])
        good_here[:] = 0
        for k in range(kept):
            flat[good_cells[k]] = (margin[k] >= 0) & (clearance[k] >= 0)
        out[m] = dilation.erode(good_here, rules.around, safe)


@kernel
def smooth_cells(h: Array32, smooth: Flags, foot_radius: float, sparse: bool) -> tuple[Array32, NDArray[np.int32]]:
    """Foot centres (3, m) [m] on the smooth cells of ``h`` (n, n), every other one if ``sparse``; and their numbers.

    Numbers (m,) are ix · n + iy. Of a chequerboard those are taken that hold the map's middle.
    """
    n = h.shape[0]
    xyz, cells, m = np.empty((3, n * n), np.float32), np.empty(n * n, np.int32), 0
    for i in range(n):
        for j in range(n):
            # What is smooth is known.
            if smooth[i, j] and not (sparse and (i + j) % 2 == 1):
                place(i, j, n, h[i, j] + np.float32(foot_radius), xyz, m)
                cells[m] = i * n + j
                m += 1
    return xyz[:, :m].copy(), cells[:m].copy()


@kernel
def hip_cell(cycle: Cycle, n: int) -> tuple[int, int]:
    """The cell of an (n, n) map below the hip, or the nearest to it."""
    i = int(np.floor(cycle.hip_x / RESOLUTION_M + 0.5)) + n // 2
    j = int(np.floor(cycle.hip_y / RESOLUTION_M + 0.5)) + n // 2
    return min(max(i, 0), n - 1), min(max(j, 0), n - 1)


@kernel
def place(i: int, j: int, n: int, z: float, out: Array32, k: int) -> None:
    """Write the foot's centre on cell (i, j) of an (n, n) map into column ``k`` of ``out``."""
    out[0, k] = np.float32((i - n // 2) * RESOLUTION_M)
    out[1, k] = np.float32((j - n // 2) * RESOLUTION_M)
    out[2, k] = np.float32(z)
