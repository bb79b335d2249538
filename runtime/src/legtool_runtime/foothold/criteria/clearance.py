"""How high a leg is above the terrain, in compiled code: look-ups in tables of dilated heights."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

Array32 = NDArray[np.float32]


class CellGrid(NamedTuple):
    """Where a table of dilated heights lies: x and y of its lower corner [m], side of a cell [m], cells a side."""

    origin: float
    fine: float
    cells: int


class Tables(NamedTuple):
    """Heights dilated by the foot and by the bounding region of the leg, each with its grid and greatest height [m]."""

    thin: Array32
    thin_grid: CellGrid
    thin_top: float
    thick: Array32
    thick_grid: CellGrid
    thick_top: float


@kernel
def lowest(z: Array32) -> float:
    """The least of some heights [m], a little less rather than more; in whole numbers, which make vector code."""
    scale = np.float32(4096.0)
    low = np.int32(2**30)
    for j in range(z.shape[0]):
        value = np.int32(z[j] * scale)
        low = value if value < low else low
    return (low - 1) / 4096.0


@kernel
def clear_points(
    begin: Array32,
    end: Array32,
    share: float,
    table: Array32,
    grid: CellGrid,
    index: NDArray[np.int32],
    below: Array32,
    clearance: Array32,
) -> None:
    """Lower ``clearance`` (n,) to the height above ``table`` of the points at ``share`` from ``begin`` to ``end``.

    Args:
        begin: (3, n) one end of each link [m].
        end: (3, n) the other.
        share: 0 to 1.
        table: from :func:`legtool_runtime.foothold.criteria.dilation.dilate`.
        grid: where the table lies.
        index: (n,) to work in.
        below: (n,) to work in.
        clearance: least clearance so far [m].
    """
    f, per, low = np.float32(share), np.float32(1.0 / grid.fine), np.float32(grid.origin)
    zero, highest = np.float32(0.0), np.float32(grid.cells - 1)
    stride = np.int32(grid.cells)
    g = np.float32(1.0) - f
    n = clearance.shape[0]
    x0, y0, z0, x1, y1, z1 = begin[0], begin[1], begin[2], end[0], end[1], end[2]
    # Three loops: the first and the last become vector code, the look-up cannot.
    for j in range(n):
        u = (g * x0[j] + f * x1[j] - low) * per
        v = (g * y0[j] + f * y1[j] - low) * per
        u = u if u > zero else zero
        v = v if v > zero else zero
        u = u if u < highest else highest
        v = v if v < highest else highest
        index[j] = np.int32(u) * stride + np.int32(v)
    flat = table.reshape(-1)
    for j in range(n):
        below[j] = flat[np.uint32(index[j])]
    for j in range(n):
        above = g * z0[j] + f * z1[j] - below[j]
        clearance[j] = above if above < clearance[j] else clearance[j]


@kernel
def clear_leg(
    points: Array32,
    links: Array32,
    foot: Array32,
    tables: Tables,
    index: NDArray[np.int32],
    below: Array32,
    clearance: Array32,
) -> None:
    """Lower ``clearance`` (n,) to that of legs bent by :func:`bend_leg`.

    Args:
        points: (p, 3) along the leg: link (0 thigh, 1 shank), share from its upper end, 1 where the leg is thick.
        links: (6, n) from :func:`bend_leg`.
        foot: (3, n) feet [m].
        tables: of the terrain.
        index: (n,) to work in.
        below: (n,) to work in.
        clearance: least clearance so far [m].
    """
    knee, hip = links[0:3], links[3:6]
    low_hip, low_knee, low_foot = lowest(links[5]), lowest(links[2]), lowest(foot[2])
    for p in range(points.shape[0]):
        share, table, grid, top = points[p, 1], tables.thin, tables.thin_grid, tables.thin_top
        if points[p, 2] > np.float32(0.5):
            table, grid, top = tables.thick, tables.thick_grid, tables.thick_top
        # Where all points are above the whole table, there is nothing to look up.
        if points[p, 0] > np.float32(0.5):
            if (1.0 - share) * low_knee + share * low_foot < top:
                clear_points(knee, foot, share, table, grid, index, below, clearance)
        elif (1.0 - share) * low_hip + share * low_knee < top:
            clear_points(hip, knee, share, table, grid, index, below, clearance)
