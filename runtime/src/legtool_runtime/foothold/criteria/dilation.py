"""What the criteria need of one heightmap, whatever the hip height: dilated heights and roughness, in compiled code.

The terrain is the solid below the cells' tops: each known cell is a square column. A ball of radius r around p is clear
of it exactly if p lies above the dilation of the heights by the ball, so that a collision check is one look-up. The
dilation is tabulated on a grid finer than the cells.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

Array32 = NDArray[np.float32]
Flags = NDArray[np.uint8]


def ball(radius_m: float, resolution_m: float, fineness: int) -> tuple[NDArray[np.int32], Array32]:
    """The columns that a ball can touch, for each place of its centre within a cell.

    Returns:
        (n, 4) sub-cell a, b and neighbour offset i, j; (n,) height that is added to the neighbour's top [m].
    """
    reach = int(np.ceil(radius_m / resolution_m))
    cells, heights = [], []
    for a in range(fineness):
        for b in range(fineness):
            place = ((np.array([a, b]) + 0.5) / fineness - 0.5) * resolution_m
            for i in range(-reach, reach + 1):
                for j in range(-reach, reach + 1):
                    gap = np.maximum(np.abs(np.array([i, j]) * resolution_m - place) - 0.5 * resolution_m, 0.0)
                    left = radius_m**2 - gap @ gap
                    if left > 0:
                        cells.append((a, b, i, j))
                        heights.append(np.sqrt(left))
    return np.array(cells, np.int32), np.array(heights, np.float32)


def disc(radius_m: float, resolution_m: float) -> NDArray[np.int32]:
    """(n, 2) offsets i, j of the cells whose centres lie within a radius, in order."""
    reach = int(radius_m / resolution_m + 1e-6)
    cells = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T
    near = np.hypot(*cells.T) * resolution_m <= radius_m + 1e-6
    return np.ascontiguousarray(cells[near], dtype=np.int32)


@kernel
def fill(heights: Array32, out: Array32) -> bool:
    """Copy ``heights`` (n, n) and give unknown cells the highest height known beside them, ring by ring.

    Returns whether any cell is known.
    """
    n = heights.shape[0]
    missing, known = 0, False
    for i in range(n):
        for j in range(n):
            h = heights[i, j]
            out[i, j] = h
            if h == h:
                known = True
            else:
                missing += 1
    if not known:
        return False
    before = out.copy() if missing > 0 else out
    while missing > 0:
        for i in range(n):
            for j in range(n):
                if before[i, j] == before[i, j]:
                    continue
                best = np.float32(-np.inf)
                for di in range(max(i - 1, 0), min(i + 2, n)):
                    for dj in range(max(j - 1, 0), min(j + 2, n)):
                        if before[di, dj] > best:
                            best = before[di, dj]
                if best > -np.inf:
                    out[i, j] = best
                    missing -= 1
        before[:] = out
    return True


@kernel
def dilate(filled: Array32, cells: NDArray[np.int32], rise: Array32, fineness: int, out: Array32) -> float:
    """Dilate by a ball (see :func:`ball`) onto a grid ``fineness`` times as fine, with a border of -inf around.

    Args:
        filled: (n, n) heights [m], all finite.
        cells: from :func:`ball`.
        rise: from :func:`ball`.
        fineness: sub-cells a side.
        out: (fineness n + 2, fineness n + 2) written [m].

    Returns:
        the greatest height written.
    """
    n = filled.shape[0]
    reach = 0
    for k in range(cells.shape[0]):
        reach = max(reach, cells[k, 2])
    # Rows end to end, with room for the reach between them: one long loop for each neighbour, which is vector code.
    width = n + 2 * reach
    padded = np.full((width, width), np.float32(-np.inf), np.float32)
    padded[reach : reach + n, reach : reach + n] = filled
    flat = padded.reshape(-1)
    best = np.empty((n - 1) * width + n, np.float32)
    out[:] = np.float32(-np.inf)
    into, across = out.reshape(-1), out.shape[1]
    k = 0
    while k < cells.shape[0]:
        a, b = cells[k, 0], cells[k, 1]
        best[:] = np.float32(-np.inf)
        while k < cells.shape[0] and cells[k, 0] == a and cells[k, 1] == b:
            source, w = flat[(reach + cells[k, 2]) * width + reach + cells[k, 3] :], rise[k]
            for j in range(best.shape[0]):
                value = source[j] + w
                best[j] = value if value > best[j] else best[j]
            k += 1
        for i in range(n):
            row, target = best[i * width : i * width + n], into[(1 + i * fineness + a) * across + 1 + b :]
            for j in range(n):
                target[np.uint32(j * fineness)] = row[j]  # unsigned, and so never counted from the end
    # Over the middle of the highest cell the ball's whole radius is added.
    return float(filled.max() + rise.max())


@kernel
def smooth(heights: Array32, resolution: float, most_mean: float, most_deviation: float, out: Flags) -> None:
    """Write 1 where mean and standard deviation of the slopes to the 8 neighbours are small enough, else 0.

    A cell with an unknown neighbour, or at the border of the map, is not: its slopes are unknown.
    """
    n = heights.shape[0]
    side = np.float32(1.0 / resolution)
    diagonal = np.float32(np.sqrt(0.5) / resolution)
    eighth = np.float32(0.125)
    mean_limit, variance_limit = np.float32(most_mean), np.float32(most_deviation * most_deviation)
    out[:] = 0
    for i in range(1, n - 1):
        up, row, down, flags = heights[i - 1], heights[i], heights[i + 1], out[i]
        for j in range(1, n - 1):
            h = row[j]
            a, b = abs(up[j] - h) * side, abs(down[j] - h) * side
            c, d = abs(row[j - 1] - h) * side, abs(row[j + 1] - h) * side
            e, f = abs(up[j - 1] - h) * diagonal, abs(up[j + 1] - h) * diagonal
            g, k = abs(down[j - 1] - h) * diagonal, abs(down[j + 1] - h) * diagonal
            mean = (a + b + c + d + e + f + g + k) * eighth
            square = (a * a + b * b + c * c + d * d + e * e + f * f + g * g + k * k) * eighth
            flags[j] = (mean <= mean_limit) & (square - mean * mean <= variance_limit)


@kernel
def erode(safe: Flags, offsets: NDArray[np.int32], out: Flags) -> int:
    """Keep the cells of ``safe`` (n, n) with all cells at ``offsets`` (m, 2) around them safe; returns how many.

    Cells beyond the map are not safe.
    """
    n = safe.shape[0]
    reach = 0
    for k in range(offsets.shape[0]):
        reach = max(reach, offsets[k, 0], offsets[k, 1])
    # Rows end to end, as in `dilate`; what lies between two rows is cleared.
    flat, first, inside = safe.reshape(-1), reach * n + reach, n - 2 * reach
    kept = np.ones((inside - 1) * n + inside, np.uint8)
    for k in range(offsets.shape[0]):
        source = flat[first + offsets[k, 0] * n + offsets[k, 1] :]
        for j in range(kept.shape[0]):
            kept[j] &= source[j]
    for i in range(inside - 1):
        kept[i * n + inside : (i + 1) * n] = 0
    out[:] = 0
    out.reshape(-1)[first : first + kept.shape[0]] = kept
    total = 0
    for j in range(kept.shape[0]):
        total += kept[j]
    return total
