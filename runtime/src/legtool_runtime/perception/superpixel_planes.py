"""Planes of superpixels: RANSAC, and a least-squares plane through its inliers."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.perception.superpixel_kernels import Floats, Floor, Ints


class Ransac(NamedTuple):
    """How planes are found.

    Attributes:
        trials: planes that are tried beside the one that the cluster has.
        sample: members by which they are judged.
        tolerance: distance of an inlier [m].
        least: pixels that make a superpixel.
    """

    trials: int
    sample: int
    tolerance: float
    least: int


@kernel
def update(
    floor: Floor,
    start: Ints,
    order: Ints,
    count: int,
    ransac: Ransac,
    clusters: Floats,
    keep: NDArray[np.bool_],
) -> None:
    """New centroids, and normals by RANSAC with a least-squares plane through its inliers.

    Args:
        floor: the image.
        start, order: members of cluster c are the flat pixels ``order[start[c]:start[c + 1]]``.
        count: number of clusters.
        ransac: its settings.
        clusters: (k, 9) of which the first ``count`` are changed.
        keep: (k,) is filled with whether a cluster has enough members to live on; the others stay as they are.
    """
    channels = floor.channels
    trials, sample_size, tolerance, least = ransac
    sample = np.empty((sample_size, 3), np.float32)
    state = np.uint64(0)
    for c in range(count):
        size = start[c + 1] - start[c]
        keep[c] = size >= least
        if not keep[c]:
            continue
        for s in range(sample_size):
            i = order[start[c] + (s * size) // sample_size]
            for axis in range(3):
                sample[s, axis] = channels[axis, i]
        normal_x, normal_y, normal_z = clusters[c, 3], clusters[c, 4], clusters[c, 5]
        at_x, at_y, at_z = clusters[c, 0], clusters[c, 1], clusters[c, 2]
        most = 0
        state = np.uint64(0x9E3779B97F4A7C15) + np.uint64(c)
        for trial in range(trials + 1):
            if trial == 0:  # the plane that the cluster has
                hx, hy, hz = normal_x, normal_y, normal_z
                ox, oy, oz = at_x, at_y, at_z
            else:
                state, a = _draw(state, sample_size)
                state, b = _draw(state, sample_size)
                state, d = _draw(state, sample_size)
                ox, oy, oz = sample[a, 0], sample[a, 1], sample[a, 2]
                ux, uy, uz = sample[b, 0] - ox, sample[b, 1] - oy, sample[b, 2] - oz
                vx, vy, vz = sample[d, 0] - ox, sample[d, 1] - oy, sample[d, 2] - oz
                hx, hy, hz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
                length = np.sqrt(hx * hx + hy * hy + hz * hz)
                # Three points in a line, nearly, say nothing.
                if length < np.float32(1e-5) or length < np.float32(0.05) * np.sqrt(
                    (ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz)
                ):
                    continue
                sign = np.float32(1.0) if hz > 0 else np.float32(-1.0)
                hx, hy, hz = sign * hx / length, sign * hy / length, sign * hz / length
            inliers = 0
            for s in range(sample_size):
                offset = hx * (sample[s, 0] - ox) + hy * (sample[s, 1] - oy) + hz * (sample[s, 2] - oz)
                inliers += abs(offset) < np.float32(tolerance)
            if inliers > most:
                most = inliers
                normal_x, normal_y, normal_z, at_x, at_y, at_z = hx, hy, hz, ox, oy, oz
        plane = (normal_x, normal_y, normal_z, at_x, at_y, at_z)
        _fit(floor, order, start[c], start[c + 1], np.float32(tolerance), plane, clusters, c)


@kernel
def _draw(state: Any, below: int) -> tuple[Any, Any]:
    """The next state of an xorshift generator and a whole number below ``below``."""
    state ^= state << np.uint64(13)
    state ^= state >> np.uint64(7)
    state ^= state << np.uint64(17)
    return state, np.int64((state >> np.uint64(33)) % np.uint64(below))


@kernel
def _fit(floor: Floor, order: Ints, begin: int, end: int, tolerance: Any, plane: Any, clusters: Floats, c: int) -> None:
    """Set a cluster's centroid and normal from the members within ``tolerance`` [m] of a plane: z = ax + by + c.

    The members are the flat pixels ``order[begin:end]``; ``plane`` is x, y, z of its normal and of a point [m].
    """
    channels, side, focal_length = floor
    middle = 0.5 * side - 0.5
    nx, ny, nz, px, py, pz = plane
    n = 0
    sx, sy, sz, sxx, sxy, syy, sxz, syz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for m in range(begin, end):
        i = order[m]
        x, y, z = channels[0, i] - px, channels[1, i] - py, channels[2, i] - pz
        if abs(nx * x + ny * y + nz * z) < tolerance:
            n += 1
            sx, sy, sz = sx + x, sy + y, sz + z
            sxx, sxy, syy, sxz, syz = sxx + x * x, sxy + x * y, syy + y * y, sxz + x * z, syz + y * z
    if n < 3:
        return
    mx, my, mz = sx / n, sy / n, sz / n
    cxx, cxy, cyy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
    cxz, cyz = sxz / n - mx * mz, syz / n - my * mz
    determinant = cxx * cyy - cxy * cxy
    # Spread along one line only: the plane stays as RANSAC left it.
    if determinant > 1e-4 * (cxx + cyy) ** 2:
        a, b = (cxz * cyy - cyz * cxy) / determinant, (cyz * cxx - cxz * cxy) / determinant
        length = np.sqrt(a * a + b * b + 1.0)
        nx, ny, nz = -a / length, -b / length, 1.0 / length
    clusters[c, 0], clusters[c, 1], clusters[c, 2] = px + mx, py + my, pz + mz
    clusters[c, 3], clusters[c, 4], clusters[c, 5] = nx, ny, nz
    scale = focal_length / -(pz + mz)
    clusters[c, 7], clusters[c, 8] = scale * (px + mx) + middle, scale * (py + my) + middle
