"""Inner loops of the superpixels: preparing the floor image, seeds, equation 10, connected parts.

The floor image is flat, side · side pixels, x-major. ``clusters`` (k, 9) float32 are the seven channels of
:class:`Floor` and the pixel's ix, iy. Their planes are found by :mod:`.superpixel_planes`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.perception import STEPPABLE

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]

#: States of a floor pixel: without data, taking part, only assumed, or removed by the health check.
EMPTY, HEALTHY, ASSUMED, REMOVED = range(4)
#: Side of the blocks of pixels within which one return says that the place was seen.
_BLOCK = 8
#: Side of the squares that connect pixels, and the mark of squares whose part is not known yet.
LINK, _UNREACHED = 3, -1


class Floor(NamedTuple):
    """The prepared floor image.

    Attributes:
        channels: (7, side²) point x, y, z [m] and normal x, y, z, levelled frame, and kind: 0 seen, 1 assumed. Pixels
            that take no part are NaN in every channel, so that every comparison with them fails.
        side: [pixels].
        focal_length: [pixels].
    """

    channels: Floats
    side: int
    focal_length: float


class SuperpixelCriteria(NamedTuple):
    """What decides which cluster a pixel belongs to.

    Attributes:
        weights: (4,) of the normal, plane, world and compactness terms.
        limits: (2,) largest normal (1 - cosine) and plane distances [m], which a member must not exceed.
        step: distance of seeds [pixels], by which the world and pixel terms are scaled.
    """

    weights: Floats
    limits: Floats
    step: float


@kernel
def prepare(
    points: Floats,
    normals: Floats,
    labels: NDArray[np.uint8],
    upright: float,
    ground: Floats,
    floor: Floor,
    state: NDArray[np.uint8],
) -> None:
    """Health check (V-D1) and assumed ground (V-D2).

    Assumed ground fills only places that no return fell near to, so that it never refills what the health check
    removed.

    Args:
        points: (side, side, 3) levelled frame [m], NaN where nothing was seen.
        normals: (side, side, 3) levelled frame.
        labels: (side, side) index into LABELS.
        upright: least z of a healthy pixel's normal.
        ground: (4,) x, y, z of the assumed disc's centre in the levelled frame and its radius [m].
        floor: whose channels are filled.
        state: (side, side) is filled with EMPTY, HEALTHY, ASSUMED or REMOVED.
    """
    channels, side = floor.channels, floor.side
    nan = np.float32(np.nan)
    blocks = (side + _BLOCK - 1) // _BLOCK
    seen = np.zeros((blocks + 2, blocks + 2), np.bool_)
    for ix in range(side):
        for iy in range(side):
            i = ix * side + iy
            x = points[ix, iy, 0]
            healthy = False
            if x == x:
                seen[ix // _BLOCK + 1, iy // _BLOCK + 1] = True
                healthy = normals[ix, iy, 2] > upright and labels[ix, iy] == STEPPABLE
                state[ix, iy] = HEALTHY if healthy else REMOVED
            else:
                state[ix, iy] = EMPTY
            for axis in range(3):
                channels[axis, i] = points[ix, iy, axis] if healthy else nan
                channels[3 + axis, i] = normals[ix, iy, axis] if healthy else nan
            channels[6, i] = np.float32(0.0) if healthy else nan
    down = -ground[2]
    if not (ground[3] > 0 and down > 0):
        return
    per_cell = down / np.float32(floor.focal_length)
    radius2 = ground[3] * ground[3]
    middle = np.float32(0.5 * side - 0.5)
    for bx in range(blocks):
        for by in range(blocks):
            if seen[bx : bx + 3, by : by + 3].any():
                continue
            for ix in range(bx * _BLOCK, min(side, (bx + 1) * _BLOCK)):
                for iy in range(by * _BLOCK, min(side, (by + 1) * _BLOCK)):
                    x, y = (np.float32(ix) - middle) * per_cell, (np.float32(iy) - middle) * per_cell
                    if (x - ground[0]) ** 2 + (y - ground[1]) ** 2 < radius2:
                        i = ix * side + iy
                        state[ix, iy] = ASSUMED
                        channels[0, i], channels[1, i], channels[2, i] = x, y, -down
                        channels[3, i], channels[4, i], channels[5, i] = 0.0, 0.0, 1.0
                        channels[6, i] = 1.0


@kernel
def seed(
    floor: Floor,
    assignment: Ints,
    step: float,
    least: int,
    limit: float,
    clusters: Floats,
    count: int,
) -> int:
    """Add a cluster in each grid square that holds ``least`` pixels of no cluster; the new number of clusters.

    With no cluster yet this is V-D3's uniform sampling. The seed is moved to the centroid of the free pixels in the
    step/4 neighbourhood of the square's centre, or in the square if there are none, and takes the values of the pixel
    closest to it. New seeds closer than half a step on one plane (``limit`` apart [m]) would starve each other: only
    one of them is set.
    """
    channels, side = floor.channels, floor.side
    squares = int(np.round(side / step))
    old = count
    for gx in range(squares):
        for gy in range(squares):
            x0, x1 = int(gx * side / squares), int((gx + 1) * side / squares)
            y0, y1 = int(gy * side / squares), int((gy + 1) * side / squares)
            quarter = max(1, int(step / 8))
            sum_x, sum_y, free = 0.0, 0.0, 0
            near_x, near_y, near = 0.0, 0.0, 0
            for ix in range(x0, x1):
                for iy in range(y0, y1):
                    i = ix * side + iy
                    if assignment[i] < 0 and channels[0, i] == channels[0, i]:
                        sum_x, sum_y, free = sum_x + ix, sum_y + iy, free + 1
                        if abs(2 * ix - x0 - x1) <= 2 * quarter and abs(2 * iy - y0 - y1) <= 2 * quarter:
                            near_x, near_y, near = near_x + ix, near_y + iy, near + 1
            if free < least or count >= clusters.shape[0]:
                continue
            at_x, at_y = (near_x / near, near_y / near) if near else (sum_x / free, sum_y / free)
            best, chosen = np.inf, -1
            for ix in range(x0, x1):
                for iy in range(y0, y1):
                    i = ix * side + iy
                    distance = (ix - at_x) ** 2 + (iy - at_y) ** 2
                    if distance < best and assignment[i] < 0 and channels[0, i] == channels[0, i]:
                        best, chosen = distance, i
            for channel in range(7):
                clusters[count, channel] = channels[channel, chosen]
            clusters[count, 7], clusters[count, 8] = chosen // side, chosen % side
            if not _taken(clusters, old, count, 0.5 * step, limit):
                count += 1
    return count


@kernel
def _taken(clusters: Floats, first: int, count: int, reach: float, limit: float) -> bool:
    """Whether the last cluster lies on the plane of one from ``first`` on that is less than ``reach`` pixels away."""
    for c in range(first, count):
        if abs(clusters[c, 7] - clusters[count, 7]) < reach and abs(clusters[c, 8] - clusters[count, 8]) < reach:
            offset = 0.0
            for axis in range(3):
                offset += (clusters[count, axis] - clusters[c, axis]) * clusters[c, 3 + axis]
            if abs(offset) < limit and clusters[c, 6] == clusters[count, 6]:
                return True
    return False


@kernel
def assign(
    floor: Floor,
    clusters: Floats,
    count: int,
    reach: int,
    criteria: SuperpixelCriteria,
    best: Floats,
    assignment: Ints,
) -> None:
    """Give each pixel to the cluster of least distance (equations 10-14) among those whose window it lies in.

    Args:
        floor: the image.
        clusters: of which the first ``count`` are looked at.
        count: number of clusters.
        reach: half the window's side [pixels].
        criteria: weights and limits of the terms.
        best: (side²,) scratch.
        assignment: (side²,) is filled with each pixel's cluster, -1 for none.
    """
    channels, side, focal_length = floor
    weights, limits, step = criteria
    best[:] = np.inf
    assignment[:] = -1
    normal_limit, plane_limit = limits
    one = np.float32(1.0)
    for c in range(count):
        px, py, pz = clusters[c, 0], clusters[c, 1], clusters[c, 2]
        nx, ny, nz, kind = clusters[c, 3], clusters[c, 4], clusters[c, 5], clusters[c, 6]
        cx, cy = clusters[c, 7], clusters[c, 8]
        wn, wp = weights[0] / normal_limit, weights[1] / plane_limit
        ww = weights[2] * np.float32(focal_length) / (np.float32(step) * max(abs(pz), np.float32(0.01)))
        wc = weights[3] / np.float32(step)
        label = np.int32(c)
        middle_x, middle_y = int(cx), int(cy)
        first, last = max(0, middle_y - reach), min(side, middle_y + reach + 1)
        if first >= last:
            continue
        across = np.uint64(last - first)
        for ix in range(max(0, middle_x - reach), min(side, middle_x + reach + 1)):
            # Unsigned, so that the compiler need not think of negative indices and takes eight pixels at a time.
            begin = np.uint64(ix * side + first)
            offset_x = np.float32(ix) - cx
            from_y = np.float32(first) - cy
            for j in range(across):
                i = begin + j
                dx, dy, dz = channels[0, i] - px, channels[1, i] - py, channels[2, i] - pz
                normal = one - (channels[3, i] * nx + channels[4, i] * ny + channels[5, i] * nz)
                plane = abs(dx * nx + dy * ny + dz * nz)
                offset_y = np.float32(np.int32(j)) + from_y
                total = (
                    wn * normal
                    + wp * plane
                    + ww * np.sqrt(dx * dx + dy * dy + dz * dz)
                    + wc * np.sqrt(offset_x * offset_x + offset_y * offset_y)
                )
                better = (
                    (total < best[i]) & (normal <= normal_limit) & (plane <= plane_limit) & (channels[6, i] == kind)
                )
                best[i] = total if better else best[i]
                assignment[i] = label if better else assignment[i]


@kernel
def members(assignment: Ints, count: int, start: Ints, order: Ints) -> None:
    """Pixels by cluster: those of cluster c are ``order[start[c]:start[c + 1]]``, in rising order."""
    start[: count + 1] = 0
    for i in range(assignment.size):
        if assignment[i] >= 0:
            start[assignment[i] + 1] += 1
    for c in range(count):
        start[c + 1] += start[c]
    fill = start[:count].copy()
    for i in range(assignment.size):
        c = assignment[i]
        if c >= 0:
            order[fill[c]] = i
            fill[c] += 1


@kernel
def separate(assignment: Ints, count: int, squares: Ints, across: int, start: Ints, order: Ints) -> None:
    """Leave each cluster its largest connected part and free the others, which seeds of their own may take then.

    Pixels are connected through squares of LINK pixels that touch, so that a sparse image does not fall to dust:
    ``squares`` (n,) names each pixel's, in an array ``across`` wide with a free square on each side.
    """
    part, pixels = np.zeros(across * across, np.int32), np.empty(across * across + 1, np.int64)
    stack, square = np.empty(across * across, np.int32), np.empty(order.size, np.int32)
    written = 0
    for c in range(count):
        begin, end = start[c], start[c + 1]
        start[c] = written
        for m in range(begin, end):
            square[m] = squares[order[m]]
            part[square[m]] = _UNREACHED
        parts, largest = 0, 0
        for m in range(begin, end):
            if part[square[m]] == _UNREACHED:
                parts += 1
                pixels[parts] = 0
                part[square[m]] = parts
                stack[0], height = square[m], 1
                while height:
                    height -= 1
                    middle = stack[height]
                    for row in range(middle - across, middle + across + 1, across):
                        for near in range(row - 1, row + 2):
                            if part[near] == _UNREACHED:
                                part[near] = parts
                                stack[height] = near
                                height += 1
            pixels[part[square[m]]] += 1
        for n in range(1, parts + 1):
            largest = n if largest == 0 or pixels[n] > pixels[largest] else largest
        for m in range(begin, end):
            if part[square[m]] == largest:
                order[written] = order[m]
                written += 1
            else:
                assignment[order[m]] = -1
        for m in range(begin, end):
            part[square[m]] = 0
    start[count] = written
