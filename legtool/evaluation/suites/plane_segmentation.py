"""The baseline: planes cut out of an elevation map, as pipelines without an egocan do it (QuadPiPS, VIII-B3).

Cells whose neighbourhood is flat and not steep are joined with neighbours of like height and slope; a piece that one
plane does not fit is divided by RANSAC until one does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from legtool.evaluation.suites.region_scores import Patches
from legtool.sim.walks.flat_ground import local_planes
from legtool.sim.worlds.faces import FaceMap
from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]

#: A flat neighbourhood of 3 × 3 cells deviates at most this from its plane [m], and is at most this steep.
_ROUGHNESS, _STEEPEST = 0.008, np.tan(np.deg2rad(35.0))
#: Neighbouring cells of one piece: largest offset from each other's planes [m], and angle between the normals [rad].
_OFFSET, _TURN = 0.01, np.deg2rad(12.0)
#: Least z of a plane's normal, as in the health check of the superpixels.
_UPRIGHT = 0.5
#: A plane's inliers [m], the share of a piece that it must fit, and RANSAC's trials.
_INLIER, _ENOUGH, _TRIALS = 0.012, 0.97, 40


def segment_planes(heights: HeightMap, truth: FaceMap, *, least_area: float) -> Patches:
    """Planar pieces of an elevation map, as patches of a face map's cells.

    Args:
        heights: the map.
        truth: whose cells the pieces are given in; one cell of the map covers several.
        least_area: smaller pieces are left out [m²].
    """
    z = heights.heights.astype(np.float64)
    slope_x, slope_y, off = local_planes(z, heights.resolution_m)
    with np.errstate(invalid="ignore"):
        flat = (off < _ROUGHNESS) & (np.hypot(slope_x, slope_y) < _STEEPEST)
    pieces = _pieces(z, slope_x, slope_y, flat, heights.resolution_m)
    least = max(4, int(np.ceil(least_area / heights.resolution_m**2)))
    rng = np.random.default_rng(0)
    found: list[tuple[NDArray[np.intp], Array, Array]] = []
    corner = heights.lower_corner
    for number in range(1, int(pieces.max()) + 1):
        index = np.argwhere(pieces == number)
        xyz = np.column_stack([corner + (index + 0.5) * heights.resolution_m, z[index[:, 0], index[:, 1]]])
        found += [(index[part], *plane) for part, plane in _divide(xyz, rng, least)]
    return _patches(found, heights, truth)


def _pieces(z: Array, slope_x: Array, slope_y: Array, flat: NDArray[np.bool_], resolution: float) -> NDArray[np.int64]:
    """Number from 1 of each flat cell's piece, 0 elsewhere."""
    count = int(flat.sum())
    number = np.full(z.shape, -1)
    number[flat] = np.arange(count)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(z)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    edges = []
    for axis, slope in ((0, slope_x), (1, slope_y)):
        here = tuple(slice(None, -1) if a == axis else slice(None) for a in range(2))
        there = tuple(slice(1, None) if a == axis else slice(None) for a in range(2))
        with np.errstate(invalid="ignore"):
            step = z[there] - z[here] - 0.5 * (slope[there] + slope[here]) * resolution
            alike = (np.abs(step) < _OFFSET) & (np.sum(normal[here] * normal[there], axis=-1) > np.cos(_TURN))
        joined = flat[here] & flat[there] & alike
        edges.append(np.stack([number[here][joined], number[there][joined]]))
    a, b = np.concatenate(edges, axis=1)
    _, parts = connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(count, count)), directed=False)
    out = np.zeros(z.shape, dtype=np.int64)
    out[flat] = parts + 1
    return out


def _divide(xyz: Array, rng: np.random.Generator, least: int) -> list[tuple[NDArray[np.intp], tuple[Array, Array]]]:
    """Parts (indices) of points (n, 3) that one plane fits, each with a point and a normal of it."""
    left = np.arange(len(xyz))
    out = []
    while len(left) >= least:
        point, normal = _fit(xyz[left])
        inlier = np.abs((xyz[left] - point) @ normal) < _INLIER
        if inlier.mean() < _ENOUGH:
            best = inlier
            for _ in range(_TRIALS):
                a, b, c = xyz[rng.choice(left, 3, replace=False)]
                across = np.cross(b - a, c - a)
                length = np.linalg.norm(across)
                if length < 1e-6:
                    continue
                hit = np.abs((xyz[left] - a) @ across) < _INLIER * length
                best = hit if hit.sum() > best.sum() else best
            inlier = best
            if inlier.sum() < least:
                break
            point, normal = _fit(xyz[left[inlier]])
        if normal[2] > _UPRIGHT:
            out.append((left[inlier], (point, normal)))
        left = left[~inlier]
    return out


def _fit(xyz: Array) -> tuple[Array, Array]:
    middle = xyz.mean(axis=0)
    normal = np.linalg.svd(xyz - middle, full_matrices=False)[2][2]
    return middle, normal if normal[2] > 0 else -normal


def _patches(found: list[tuple[NDArray[np.intp], Array, Array]], heights: HeightMap, truth: FaceMap) -> Patches:
    block = round(heights.resolution_m / truth.resolution_m)
    offset = np.rint((heights.lower_corner - truth.corner) / truth.resolution_m).astype(int)
    inner = np.stack(np.meshgrid(np.arange(block), np.arange(block), indexing="ij"), axis=-1).reshape(1, -1, 2)
    cells = []
    for index, _, _ in found:
        at = (index[:, None] * block + offset + inner).reshape(-1, 2)
        inside = ((at >= 0) & (at < truth.faces.shape)).all(axis=1)
        cells.append(at[inside, 0] * truth.faces.shape[1] + at[inside, 1])
    start = np.append(0, np.cumsum([len(c) for c in cells])).astype(np.int64)
    return Patches(
        np.concatenate([*cells, np.empty(0, np.int64)]).astype(np.int64),
        start,
        np.array([point for _, point, _ in found]).reshape(-1, 3),
        np.array([normal for _, _, normal in found]).reshape(-1, 3),
    )
