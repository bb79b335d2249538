"""All criteria of one heightmap together, in compiled code: for one hip height, and counted over many."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.foothold import kernels, terrain
from legtool_runtime.foothold.kernels import Cycle, Grid, Leg
from legtool_runtime.foothold.settings import RESOLUTION_M

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Flags = NDArray[np.uint8]

#: Bits that say why a cell is unsafe.
TR, LC, KF, FC, UNKNOWN, MARGIN = 1, 2, 4, 8, 16, 32
#: Samples of the swing path (FC), of the leg's swing (touchdown left out) and of its stance (touchdown included).
PATH_SAMPLES, SWING_SAMPLES, STANCE_SAMPLES = 24, 16, 5


@kernel
def lift_off(cycle: Cycle, filled: Array32, smooth: Flags, around: NDArray[np.int32]) -> tuple[float, float, float]:
    """Where the foot lifts off: x, y and the terrain's height there [m].

    The foot has stood there, so of the cells around the cycle's lift-off point it is the nearest one with smooth
    terrain all over the uncertainty radius. With no such cell within 0.2 m, or off the map, it is the point itself; the
    ground off the map is as high as the map's edge.
    """
    n = filled.shape[0]
    half = n // 2
    u, v = cycle.lift_x / RESOLUTION_M + half, cycle.lift_y / RESOLUTION_M + half
    i, j = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
    if not (0 <= i < n and 0 <= j < n):
        return cycle.lift_x, cycle.lift_y, float(filled[min(max(i, 0), n - 1), min(max(j, 0), n - 1)])
    best, at_i, at_j = (0.2 / RESOLUTION_M) ** 2, -1, -1
    for p in range(max(i - 10, 0), min(i + 11, n)):
        for q in range(max(j - 10, 0), min(j + 11, n)):
            distance = (p - u) ** 2 + (q - v) ** 2
            if distance < best - 1e-9:
                good = True
                for k in range(around.shape[0]):
                    p2, q2 = p + around[k, 0], q + around[k, 1]
                    if not (0 <= p2 < n and 0 <= q2 < n) or not smooth[p2, q2]:
                        good = False
                        break
                if good:
                    best, at_i, at_j = distance, p, q
    if at_i < 0:
        return cycle.lift_x, cycle.lift_y, float(filled[i, j])
    return (at_i - half) * RESOLUTION_M, (at_j - half) * RESOLUTION_M, float(filled[at_i, at_j])


@kernel
def prepare(
    h: Array32,
    cycle: Cycle,
    foot_radius: float,
    thin: tuple[NDArray[np.int32], Array32, int],
    thick: tuple[NDArray[np.int32], Array32, int],
    limits: tuple[float, float, float, float],
    thin_table: Array32,
    thick_table: Array32,
    around: NDArray[np.int32],
    box: tuple[int, int, int, int],
    flags: Flags,
    xyz: Array32,
) -> tuple[int, Cycle, float, float, float]:
    """All that does not depend on the hip height, but FC: tables, TR into ``flags``, candidates into ``xyz`` (3, n).

    Returns how many candidates there are, the cycle from the true lift-off, the foot's height there, the tables' tops.
    """
    n = h.shape[0]
    half, resolution = n // 2, RESOLUTION_M
    filled = np.empty((n, n), np.float32)
    if not terrain.fill(h, filled):
        return 0, cycle, 0.0, 0.0, 0.0
    thin_top = terrain.dilate(filled, thin[0], thin[1], thin[2], thin_table)
    thick_top = terrain.dilate(filled, thick[0], thick[1], thick[2], thick_table)
    terrain.smooth(h, resolution, limits[0], limits[1], flags)
    lift_x, lift_y, lift_z = lift_off(cycle, filled, flags, around)
    count = 0
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            if h[i, j] == h[i, j]:
                xyz[0, count] = np.float32((i - half) * resolution)
                xyz[1, count] = np.float32((j - half) * resolution)
                xyz[2, count] = h[i, j] + np.float32(foot_radius)
                count += 1
    moved = Cycle(
        cycle.hip_x, cycle.hip_y, cycle.velocity_x, cycle.velocity_y, cycle.velocity_z, cycle.yaw_rate,
        lift_x, lift_y, cycle.swing_s, cycle.stance_s, cycle.start, cycle.height,
    )  # fmt: skip
    return count, moved, lift_z + foot_radius, thin_top, thick_top


@kernel
def table_grid(n: int, fineness: int) -> Grid:
    """Where the table of an (n, n) map lies."""
    fine = RESOLUTION_M / fineness
    return Grid(-0.5 * n * RESOLUTION_M - fine, fine, n * fineness + 2)


@kernel
def evaluate(
    h: Array32,
    leg: Leg,
    cycle: Cycle,
    hip_z: float,
    foot_radius: float,
    points: Array32,
    thin: tuple[NDArray[np.int32], Array32, int],
    thick: tuple[NDArray[np.int32], Array32, int],
    limits: tuple[float, float, float, float],
    around: NDArray[np.int32],
    box: tuple[int, int, int, int],
    reasons: Flags,
) -> None:
    """Write why each cell of ``h`` (n, n) is unsafe into ``reasons`` (n, n).

    Args:
        h: heights [m].
        leg: the leg's chain.
        cycle: the gait cycle.
        hip_z: height of the hip at touchdown [m].
        foot_radius: [m].
        points: (p, 3) along the leg, see :func:`legtool_runtime.foothold.kernels.move_leg`.
        thin: the foot's ball, see :func:`legtool_runtime.foothold.terrain.ball`, and its table's fineness.
        thick: the same for the leg.
        limits: largest mean and deviation of slopes, contact phase, lift-off phase.
        around: (m, 2) cells within the uncertainty radius.
        box: first and last + 1 cell in x, then y: only these are judged, the others left unsafe.
        reasons: written.
    """
    n = h.shape[0]
    thin_grid, thick_grid = table_grid(n, thin[2]), table_grid(n, thick[2])
    thin_table = np.empty((thin_grid.cells, thin_grid.cells), np.float32)
    thick_table = np.empty((thick_grid.cells, thick_grid.cells), np.float32)
    smooth = np.zeros((n, n), np.uint8)
    candidates = np.empty((3, n * n), np.float32)
    count, cycle, lift_z, thin_top, thick_top = prepare(
        h, cycle, foot_radius, thin, thick, limits, thin_table, thick_table, around, box, smooth, candidates
    )
    xyz = candidates[:, :count].copy()
    paths = np.empty(PATH_SAMPLES, np.float32)
    kernels.swing_phases(cycle.start, limits[2], 1.0 - limits[2], paths)
    path_clearance = np.empty(count, np.float32)
    kernels.clear_paths(cycle, lift_z, xyz, paths, thin_table, thin_grid, thin_top, path_clearance)
    phases = np.empty(SWING_SAMPLES + 1, np.float32)
    kernels.swing_phases(cycle.start, limits[3], 1.0, phases)
    margin, clearance = np.empty(count, np.float32), np.empty(count, np.float32)
    kernels.move_leg(
        leg, cycle, lift_z, hip_z, xyz, phases[:SWING_SAMPLES], STANCE_SAMPLES, points,
        thin_table, thin_grid, thin_top, thick_table, thick_grid, thick_top, False, margin, clearance,
    )  # fmt: skip
    safe = np.zeros((n, n), np.uint8)
    reasons[:] = UNKNOWN
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
    terrain.erode(safe, around, kept)
    for i in range(n):
        for j in range(n):
            if safe[i, j] and not kept[i, j]:
                reasons[i, j] = MARGIN


@kernel
def count(
    h: Array32,
    leg: Leg,
    cycle: Cycle,
    hips: Array,
    foot_radius: float,
    points: Array32,
    thin: tuple[NDArray[np.int32], Array32, int],
    thick: tuple[NDArray[np.int32], Array32, int],
    limits: tuple[float, float, float, float],
    around: NDArray[np.int32],
    out: NDArray[np.int64],
) -> None:
    """Write the number of safe cells into ``out`` (m,) for hip heights ``hips`` (m,) [m]; else as :func:`evaluate`."""
    n = h.shape[0]
    thin_grid, thick_grid = table_grid(n, thin[2]), table_grid(n, thick[2])
    thin_table = np.empty((thin_grid.cells, thin_grid.cells), np.float32)
    thick_table = np.empty((thick_grid.cells, thick_grid.cells), np.float32)
    smooth = np.zeros((n, n), np.uint8)
    candidates = np.empty((3, n * n), np.float32)
    count, cycle, lift_z, thin_top, thick_top = prepare(
        h, cycle, foot_radius, thin, thick, limits, thin_table, thick_table, around, (0, n, 0, n), smooth, candidates
    )
    if count == 0:
        return
    xyz, cells = np.empty((3, count), np.float32), np.empty(count, np.int32)
    left, k = 0, 0
    for i in range(n):
        for j in range(n):
            if h[i, j] == h[i, j]:
                if smooth[i, j]:
                    xyz[:, left] = candidates[:, k]
                    cells[left] = i * n + j
                    left += 1
                k += 1
    smooth_xyz = xyz[:, :left].copy()
    paths = np.empty(PATH_SAMPLES, np.float32)
    kernels.swing_phases(cycle.start, limits[2], 1.0 - limits[2], paths)
    path_clearance = np.empty(left, np.float32)
    kernels.clear_paths(cycle, lift_z, smooth_xyz, paths, thin_table, thin_grid, thin_top, path_clearance)
    kept = 0
    for k in range(left):
        if path_clearance[k] >= 0:
            xyz[:, kept] = smooth_xyz[:, k]
            cells[kept] = cells[k]
            kept += 1
    good = xyz[:, :kept].copy()
    phases = np.empty(SWING_SAMPLES + 1, np.float32)
    kernels.swing_phases(cycle.start, limits[3], 1.0, phases)
    margin, clearance = np.empty(kept, np.float32), np.empty(kept, np.float32)
    safe, eroded = np.empty((n, n), np.uint8), np.empty((n, n), np.uint8)
    flat = safe.reshape(-1)
    # Hip cell: a hip below the ground has no leg to stand on.
    half = n // 2
    i = min(max(int(np.floor(cycle.hip_x / RESOLUTION_M + 0.5)) + half, 0), n - 1)
    j = min(max(int(np.floor(cycle.hip_y / RESOLUTION_M + 0.5)) + half, 0), n - 1)
    for m in range(hips.shape[0]):
        if hips[m] <= h[i, j]:
            continue
        kernels.move_leg(
            leg, cycle, lift_z, hips[m], good, phases[:SWING_SAMPLES], STANCE_SAMPLES, points,
            thin_table, thin_grid, thin_top, thick_table, thick_grid, thick_top, True, margin, clearance,
        )  # fmt: skip
        safe[:] = 0
        for k in range(kept):
            flat[cells[k]] = (margin[k] >= 0) & (clearance[k] >= 0)
        out[m] = terrain.erode(safe, around, eroded)
