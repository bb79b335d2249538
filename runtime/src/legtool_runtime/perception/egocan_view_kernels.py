"""The egocan's inner loops over one depth image: finding its nearest returns, merging them, labels that come late.

See :mod:`.egocan_kernels` for the can, its ``shape`` and its ``scale``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.perception.egocan_kernels import SURFACE_MARGIN, Can, Floats, Labels, Transform, project

#: A point nearer to the image plane than this is not looked for in the image [m].
_CLOSEST = np.float32(0.01)
#: Cosine of the steepest incidence that is believed, 75°. Noise smears a jump in depth into points along the rays: a
#: veil from an edge to what is seen past it, whose normals are upright where the camera looks ahead. Down stairs up to
#: half of what seems to be seen at more than 75° is veil; level ground on the floor image is hardly seen beyond 70°.
GRAZING = np.float32(np.cos(np.deg2rad(75.0)))
NOT_SEEN, SAME_SURFACE, SEEN_THROUGH, HIDDEN = range(4)


class DepthView(NamedTuple):
    """A depth image.

    Attributes:
        depth: (h, w) along the optical axis [m]; NaN where there is no return.
        normals: (h, w, 3) optical frame; NaN where unknown.
        intrinsics: (4,) f_x, f_y, c_x, c_y [px].
    """

    depth: Floats
    normals: Floats
    intrinsics: Floats


@kernel
def nearest(
    view: DepthView, to_can: Transform, shape: Any, scale: Floats, fresh: Floats, source: NDArray[np.int32]
) -> None:
    """Find the nearest return of a depth image in each cell.

    Args:
        view: the image.
        to_can: optical to levelled frame.
        shape: of the can.
        scale: of the can.
        fresh: (n,) is filled with the return's distance [m], inf for none.
        source: (n,) is filled with its pixel in the flat image.
    """
    depth = view.depth
    height, width = depth.shape
    fx, fy, cx, cy = view.intrinsics
    r, t = to_can
    fresh[:] = np.inf
    a = (np.arange(width).astype(np.float32) - cx) / fx
    points, cell, distance = np.empty((3, width), np.float32), np.empty(width, np.int32), np.empty(width, np.float32)
    for v in range(height):
        b = (np.float32(v) - cy) / fy
        for axis in range(3):
            slope, offset, origin = r[axis, 0], r[axis, 1] * b + r[axis, 2], t[axis]
            for u in range(width):
                points[axis, u] = depth[v, u] * (slope * a[u] + offset) + origin
        project(points, width, shape, scale, cell, distance)
        for u in range(width):
            # NaN compares false; the first test keeps its cell, which is then no index, from being read.
            if distance[u] < np.float32(np.inf) and distance[u] < fresh[cell[u]]:
                fresh[cell[u]] = distance[u]
                source[cell[u]] = v * width + u


@kernel
def look_again(
    view: DepthView,
    from_can: Transform,
    can: Can,
    known: Labels,
    found: NDArray[np.uint8],
    pixel: NDArray[np.int32],
    index: NDArray[np.int32],
) -> None:
    """What a camera finds in the place of each point: ``found`` (n,) and at which ``pixel`` (n,) of the flat image.

    Cells that are not 0 in ``known`` (n,) or (0,) are left out; ``index`` (n,) is scratch.

    The point is the same surface if it lies in the plane of that pixel's point and normal: on a floor seen at a grazing
    angle half a pixel is many centimetres of depth. ``from_can`` leads from the levelled to the optical frame.
    """
    depth, normals = view.depth, view.normals
    near, cells = can.near, can.cells
    height, width = depth.shape
    fx, fy, cx, cy = view.intrinsics
    r, t = from_can
    half, zero, right_end, low_end = np.float32(0.5), np.float32(0.0), np.float32(width), np.float32(height)
    found[:] = NOT_SEEN
    count = 0
    if known.size:
        for i in range(near.size):
            index[count] = i
            count += (near[i] < np.float32(np.inf)) & (known[i] == 0)
    else:
        for i in range(near.size):
            index[count] = i
            count += near[i] < np.float32(np.inf)
    for k in range(count):
        i = index[k]
        px, py, pz = cells[i, 0], cells[i, 1], cells[i, 2]
        z = r[2, 0] * px + r[2, 1] * py + r[2, 2] * pz + t[2]
        if not z > _CLOSEST:
            continue
        x = r[0, 0] * px + r[0, 1] * py + r[0, 2] * pz + t[0]
        y = r[1, 0] * px + r[1, 1] * py + r[1, 2] * pz + t[1]
        u, v = x / z * fx + cx + half, y / z * fy + cy + half
        if not (u >= zero and v >= zero and u < right_end and v < low_end):
            continue
        column, row = np.int32(u), np.int32(v)
        there = depth[row, column]
        behind = there - z
        if behind != behind:  # no return there
            continue
        margin = SURFACE_MARGIN * (np.float32(1.0) + half * z * z)
        offset = (
            normals[row, column, 0] * (there * (np.float32(column) - cx) / fx - x)
            + normals[row, column, 1] * (there * (np.float32(row) - cy) / fy - y)
            + normals[row, column, 2] * behind
        )
        pixel[i] = row * np.int32(width) + column
        if abs(behind) < margin or (abs(offset) < margin and abs(behind) < half * z):
            found[i] = SAME_SURFACE
        else:
            found[i] = SEEN_THROUGH if behind > zero else HIDDEN


@kernel
def merge(
    view: DepthView,
    frame_labels: Labels,
    to_can: Transform,
    fresh: Floats,
    source: NDArray[np.int32],
    found: NDArray[np.uint8],
    can: Can,
) -> None:
    """Write a frame's nearest returns into the can, and empty the cells whose point the camera saw through.

    A return takes the cell of a point that is farther away, or that the camera saw again at its place. It takes over
    that point's label until its own is known if both are the same surface. The normal of a surface seen at a grazing
    angle is left unknown, which the health check refuses.

    ``frame_labels`` (h, w) has no pixels where the frame has no labels yet; ``fresh`` and ``source`` are what
    :func:`nearest` and ``found`` what :func:`look_again` says of this frame. ``to_can`` leads from the optical to the
    levelled frame.
    """
    depth, normals = view.depth, view.normals
    near, cells, labels = can
    width = depth.shape[1]
    fx, fy, cx, cy = view.intrinsics
    r, t = to_can
    for i in range(near.size):
        if found[i] == SEEN_THROUGH:
            near[i] = np.inf
        if not fresh[i] < np.float32(np.inf) or (fresh[i] >= near[i] and found[i] != SAME_SURFACE):
            continue
        v, u = source[i] // width, source[i] % width
        z = depth[v, u]
        x, y = z * (np.float32(u) - cx) / fx, z * (np.float32(v) - cy) / fy
        nx, ny, nz = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
        if -(nx * x + ny * y + nz * z) < GRAZING * np.sqrt(x * x + y * y + z * z):
            nx = np.float32(np.nan)
        for axis in range(3):
            cells[i, axis] = r[axis, 0] * x + r[axis, 1] * y + r[axis, 2] * z + t[axis]
            cells[i, 3 + axis] = r[axis, 0] * nx + r[axis, 1] * ny + r[axis, 2] * nz
        if frame_labels.size and frame_labels[v, u]:
            labels[i] = frame_labels[v, u]
        elif not abs(fresh[i] - near[i]) < SURFACE_MARGIN:
            labels[i] = 0
        near[i] = fresh[i]


@kernel
def relabel(
    frame_labels: Labels,
    found: NDArray[np.uint8],
    pixel: NDArray[np.int32],
    labels: Labels,
) -> None:
    """Give the points that an earlier frame saw (see :func:`look_again`) the labels of that frame."""
    width = frame_labels.shape[1]
    for i in range(labels.size):
        if found[i] == SAME_SURFACE:
            label = frame_labels[pixel[i] // width, pixel[i] % width]
            if label:
                labels[i] = label
