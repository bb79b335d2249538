"""How well planar regions lie on the faces that there are, and how much they move from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.sim.worlds.faces import FaceMap
from legtool_runtime.cache import kernel

Array = NDArray[np.float64]

#: Columns of :func:`score`.
PURE, CELLS, OVER, HEIGHT_ERROR, NORMAL_ERROR, MAIN, ON_MAIN = range(7)


@dataclass(frozen=True, eq=False)
class Patches:
    """Planar pieces of ground as sets of cells of a face map.

    Attributes:
        cells: flat indices of the cells, piece after piece.
        start: (k + 1,) where each piece begins in ``cells``.
        points: (k, 3) a point of each plane, world [m].
        normals: (k, 3) up.
    """

    cells: NDArray[np.int64]
    start: NDArray[np.int64]
    points: Array
    normals: Array

    def __len__(self) -> int:
        return len(self.points)


def polygons(corners: Sequence[Array], normals: Array, truth: FaceMap) -> Patches:
    """Convex polygons as patches: the cells whose middle lies inside when seen from above.

    Args:
        corners: k arrays (n, 3), world [m], around each polygon either way.
        normals: (k, 3) up.
        truth: whose cells.
    """
    found = [
        _inside(np.ascontiguousarray(c[:, :2]), truth.corner, truth.resolution_m, truth.faces.shape) for c in corners
    ]
    start = np.append(0, np.cumsum([len(cells) for cells in found])).astype(np.int64)
    points = np.array([c[0] for c in corners]).reshape(-1, 3)
    return Patches(np.concatenate([*found, np.empty(0, np.int64)]), start, points, normals.reshape(-1, 3))


def score(patches: Patches, truth: FaceMap, tolerance: float) -> Array:
    """Scores of each patch.

    A patch's main face is the one most of its cells lie over. It is pure if its plane is within ``tolerance`` of that
    face at every cell, and no cell lies further than ``tolerance`` beyond the face's rim.

    Returns:
        (k, 7): whether it is pure; cells; cells that hang over an edge (not over the main face, and the plane further
        than ``tolerance`` from what is there, or something stands there); mean height error [m]; angle to the plane
        through its part of the face [rad]; number of the main face; cells over it. Errors are NaN where no cell is.
    """
    out = np.empty((len(patches), 7))
    reach = round(tolerance / truth.resolution_m)
    highest = int(truth.faces.max()) + 1
    ground = _Ground(truth.faces, truth.heights, truth.free, truth.corner, truth.resolution_m)
    _score(patches.cells, patches.start, patches.points, patches.normals, ground, tolerance, reach, highest, out)
    return out


def covered(patches: Patches, truth: FaceMap, tolerance: float) -> NDArray[np.bool_]:
    """(nx, ny) cells of the face map that a patch covers, its plane within ``tolerance`` of what is there."""
    out = np.zeros(truth.faces.size, dtype=bool)
    x, y = _centres(patches.cells, truth)
    piece = np.repeat(np.arange(len(patches)), np.diff(patches.start))
    n, p = patches.normals[piece], patches.points[piece]
    z = p[:, 2] - (n[:, 0] * (x - p[:, 0]) + n[:, 1] * (y - p[:, 1])) / n[:, 2]
    close = np.abs(z - truth.heights.ravel()[patches.cells]) <= tolerance
    out[patches.cells[close]] = True
    return out.reshape(truth.faces.shape)


def jitter(before: Patches, after: Patches, truth: FaceMap) -> tuple[Array, Array]:
    """How each patch moved to the next frame: the patch there that it shares most with is taken for the same.

    Returns:
        distance between the middles [m], and intersection over union, of the patches that share anything: (m,) each.
    """
    labels = np.full(truth.faces.size, -1, dtype=np.int64)
    labels[after.cells] = np.repeat(np.arange(len(after)), np.diff(after.start))
    size = np.diff(after.start)
    middle = _middles(after, truth)
    moved, shared = [], []
    for k, here in enumerate(_middles(before, truth)):
        there = labels[before.cells[before.start[k] : before.start[k + 1]]]
        counts = np.bincount(there[there >= 0], minlength=1)
        if not counts.any():
            continue
        best = int(counts.argmax())
        moved.append(float(np.hypot(*(middle[best] - here))))
        shared.append(float(counts[best] / (len(there) + size[best] - counts[best])))
    return np.array(moved), np.array(shared)


def _middles(patches: Patches, truth: FaceMap) -> Array:
    """(k, 2) world x, y of the middle of each patch's cells [m]."""
    x, y = _centres(patches.cells, truth)
    piece = np.repeat(np.arange(len(patches)), np.diff(patches.start))
    count = np.maximum(np.diff(patches.start), 1)
    return np.column_stack([np.bincount(piece, weights=c, minlength=len(patches)) / count for c in (x, y)])


def _centres(cells: NDArray[np.int64], truth: FaceMap) -> tuple[Array, Array]:
    ix, iy = np.divmod(cells, truth.faces.shape[1])
    return (
        truth.corner[0] + (ix + 0.5) * truth.resolution_m,
        truth.corner[1] + (iy + 0.5) * truth.resolution_m,
    )


def _inside(corners: Array, corner: Array, resolution: float, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Flat indices of the cells whose centre lies inside a convex polygon (n, 2)."""
    low = np.maximum(np.floor((corners.min(axis=0) - corner) / resolution).astype(int), 0)
    high = np.minimum(np.ceil((corners.max(axis=0) - corner) / resolution).astype(int) + 1, shape)
    ix, iy = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]), indexing="ij")
    x, y = corner[0] + (ix + 0.5) * resolution, corner[1] + (iy + 0.5) * resolution
    following = np.roll(corners, -1, axis=0)
    area = np.sum(corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1])
    inside = np.ones(x.shape, dtype=bool)
    for a, b in zip(corners, following, strict=True):
        inside &= np.sign(area) * ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) >= 0
    return (ix[inside] * shape[1] + iy[inside]).astype(np.int64)


class _Ground(NamedTuple):
    """A face map, in the form that the compiled code needs; see :class:`FaceMap`.

    Attributes:
        faces: (nx, ny) number of the face that each cell shows.
        heights: (nx, ny) world [m].
        free: (nx, ny) whether that is ground, and nothing stands there.
        corner: (2,) world x, y of the lower corner [m].
        resolution: side of a cell [m].
    """

    faces: NDArray[np.int16]
    heights: NDArray[np.float32]
    free: NDArray[np.bool_]
    corner: Array
    resolution: float


@kernel
def _score(
    cells: NDArray[np.int64],
    start: NDArray[np.int64],
    points: Array,
    normals: Array,
    ground: _Ground,
    tolerance: float,
    reach: int,
    highest: int,
    out: Array,
) -> None:
    """:func:`score` into ``out`` (k, 7); ``reach`` is the tolerance [cells], ``highest`` the number of faces."""
    faces, heights, free, corner, resolution = ground
    nx, ny = faces.shape
    counts = np.zeros(highest, np.int64)
    for k in range(points.shape[0]):
        counts[:] = 0
        for m in range(start[k], start[k + 1]):
            counts[faces[cells[m] // ny, cells[m] % ny]] += 1
        main = np.argmax(counts)
        a, b = -normals[k, 0] / normals[k, 2], -normals[k, 1] / normals[k, 2]
        pure, over, on_main, error = 1.0, 0, 0, 0.0
        sums = np.zeros((3, 4))
        for m in range(start[k], start[k + 1]):
            i, j = cells[m] // ny, cells[m] % ny
            x, y = corner[0] + (i + 0.5) * resolution - points[k, 0], corner[1] + (j + 0.5) * resolution - points[k, 1]
            away = points[k, 2] + a * x + b * y - heights[i, j]
            if faces[i, j] == main and free[i, j]:
                on_main += 1
                error += abs(away)
                if abs(away) > tolerance:
                    pure = 0.0
                row = (x, y, 1.0, heights[i, j] - points[k, 2])
                for r in range(3):
                    for c in range(4):
                        sums[r, c] += row[r] * row[c]
                continue
            over += abs(away) > tolerance or not free[i, j]
            near = False
            for p in range(max(0, i - reach), min(nx, i + reach + 1)):
                for q in range(max(0, j - reach), min(ny, j + reach + 1)):
                    if (p - i) ** 2 + (q - j) ** 2 <= reach**2 and faces[p, q] == main and free[p, q]:
                        near = True
            if not near:
                pure = 0.0
        out[k, 0], out[k, 1], out[k, 2], out[k, 5], out[k, 6] = pure, start[k + 1] - start[k], over, main, on_main
        out[k, 3] = error / on_main if on_main else np.nan
        out[k, 4] = np.nan
        spread = sums[0, 0] * sums[1, 1] - sums[0, 1] * sums[0, 1]
        if on_main >= 12 and spread > 0:
            fit = np.linalg.solve(sums[:, :3] + 1e-9 * np.eye(3), np.ascontiguousarray(sums[:, 3]))
            steepness = np.sqrt((1.0 + fit[0] ** 2 + fit[1] ** 2) * (1.0 + a**2 + b**2))
            out[k, 4] = np.arccos(min(1.0, (1.0 + fit[0] * a + fit[1] * b) / steepness))
