"""Compiled code that turns depth pixels into heights of cells (see :mod:`.elevation` for the rules)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

#: A lower surface replaces a higher one at once if its variance is smaller by this factor.
_FAR_MORE_CERTAIN = 0.25
#: Least number of expected pixels before their share counts, and the most that are remembered: later looks are closer.
_LEAST_DUE, _MOST_DUE = 3.0, 30.0
#: Pixels from the image's border within which a cell's share of them is not judged.
_BORDER = 3


class Options(NamedTuple):
    """Camera and settings of one image, in the form that the compiled code needs."""

    fx: float
    fy: float
    cx: float
    cy: float
    resolution: float
    min_range: float
    max_range: float
    range_noise: float
    base_noise: float
    gate: float
    drift: float
    replace_after: float
    ceiling: float
    jump: float
    bridge: float


class DepthFrame(NamedTuple):
    """What one image says of each cell of the map, in the map's plain order.

    Attributes:
        top: (nx, ny) highest point [m], world frame.
        weight: (nx, ny) Σ 1/σ² of the points that belong to the highest surface [1/m²]; 0 in cells without points.
        total: (nx, ny) Σ (z - top)/σ² of the same points [1/m].
        pixels: (nx, ny) how many pixels hit the cell; points that only join two pixels do not count.
    """

    top: Array32
    weight: Array32
    total: Array32
    pixels: Array32


class Cells(NamedTuple):
    """The map's buffers, in which cell (i, j) of the world is stored at (i mod nx, j mod ny).

    Attributes:
        height: (nx, ny) world frame [m]; NaN where unknown.
        variance: (nx, ny) of the height [m²].
        seen: (nx, ny) when a cell was last confirmed [s].
        doubted: (nx, ny) since when something lower is seen there instead [s]; inf where nothing is.
        hits: (nx, ny) pixels that met the cell.
        due: (nx, ny) pixels that would have, had it been there throughout.
    """

    height: Array32
    variance: Array32
    seen: Array
    doubted: Array
    hits: Array32
    due: Array32


@kernel
def _project(
    image: Array32,
    v: int,
    column: Array32,
    ray: Array32,
    origin: Array32,
    size: tuple[int, int],
    limits: Array32,
    cell: NDArray[np.int32],
    point: Array32,
) -> None:
    """Project row ``v`` of an image (h, w + 2) into cells, without branches so that it compiles to vector code.

    ``column`` (w,) is x/z of each pixel's ray but the outermost. ``ray`` (3, 2) and ``origin`` (3,) are in cells for x
    and y and in metres for z; ``size`` cells along x and y; ``limits`` least and greatest depth, greatest z, jump,
    range noise, base variance. Writes ``cell`` (w,), -1 where there is no point, and ``point`` (4, w): x, y in cells,
    z [m], variance [m²].
    """
    nx, ny = size
    row = image[v]
    middle, left, right, up, down = row[1:-1], row[:-2], row[2:], image[v - 1, 1:-1], image[v + 1, 1:-1]
    least, greatest, highest, jump, noise, base = limits[0], limits[1], limits[2], limits[3], limits[4], limits[5]
    xs, ys, zs, variances = point[0], point[1], point[2], point[3]
    ax, bx, ay, by, az, bz = ray[0, 0], ray[0, 1], ray[1, 0], ray[1, 1], ray[2, 0], ray[2, 1]
    x0, y0, z0 = origin[0], origin[1], origin[2]
    for u in range(cell.shape[0]):
        d, a = middle[u], column[u]
        step = jump * d
        mixed = ((abs(d - left[u]) > step) & (abs(d - right[u]) > step)) | (
            (abs(d - up[u]) > step) & (abs(d - down[u]) > step)
        )
        slope = az * a + bz
        x, y, z = x0 + d * (ax * a + bx), y0 + d * (ay * a + by), z0 + d * slope
        spread = noise * d * d * slope
        xs[u], ys[u], zs[u], variances[u] = x, y, z, base + spread * spread
        good = (d >= least) & (d <= greatest) & (z <= highest) & (not mixed)
        inside = (x >= 0) & (x < nx) & (y >= 0) & (y < ny)
        cell[u] = np.int32(x) * ny + np.int32(y) if good & inside else -1


@kernel
def collect(
    image: Array32,
    rotation: Array,
    translation: Array,
    first: tuple[int, int],
    o: Options,
    cell: NDArray[np.int32],
    point: Array32,
    frame: DepthFrame,
) -> None:
    """Write each cell's highest surface in one image into ``frame``.

    Args:
        image: (h, w) depth [m]; the outermost pixels are not used.
        rotation: (3, 3) optical frame to world.
        translation: (3,) the camera in the world [m].
        first: index of the map's first cell along x and y, in cells of the world.
        o: camera and settings.
        cell: (k,) scratch with room for more entries than pixels.
        point: (k, 2) scratch likewise.
        frame: is overwritten.
    """
    top, weight, total, pixels = frame
    nx, ny = top.shape
    height, width = image.shape
    top[:] = -np.inf
    weight[:] = 0.0
    total[:] = 0.0
    pixels[:] = 0.0
    tops, weights, totals, counts = top.ravel(), weight.ravel(), total.ravel(), pixels.ravel()
    inverse = 1.0 / o.resolution
    scale = np.array([inverse, inverse, 1.0])
    origin = (translation * scale - np.array([first[0], first[1], 0])).astype(np.float32)
    column = ((np.arange(1, width - 1) - o.cx) / o.fx).astype(np.float32)
    ray = np.empty((3, 2), np.float32)
    highest = translation[2] + o.ceiling
    limits = np.array([o.min_range, o.max_range, highest, o.jump, o.range_noise, o.base_noise**2]).astype(np.float32)
    gate2 = np.float32(o.gate * o.gate)
    longest = np.float32((o.bridge * inverse) ** 2)
    cells = np.full((2, width - 2), -1, np.int32)
    points = np.zeros((2, 4, width - 2), np.float32)
    spare = cell.shape[0] - image.size - 16
    n = 0
    for v in range(1, height - 1):
        b = (v - o.cy) / o.fy
        for axis in range(3):
            ray[axis, 0] = rotation[axis, 0] * scale[axis]
            ray[axis, 1] = (rotation[axis, 1] * b + rotation[axis, 2]) * scale[axis]
        now, before = points[v % 2], points[1 - v % 2]
        here, above = cells[v % 2], cells[1 - v % 2]
        _project(image, v, column, ray, origin, (nx, ny), limits, here, now)
        for u in range(width - 2):
            c = here[u]
            if c < 0:
                continue
            z = now[2, u]
            precision = 1 / now[3, u]
            cell[n], point[n, 0], point[n, 1] = c, z, precision
            n += 1
            tops[c] = max(tops[c], z)
            if above[u] < 0:
                continue
            dx, dy, dz = now[0, u] - before[0, u], now[1, u] - before[1, u], z - before[2, u]
            length = dx * dx + dy * dy
            if length <= 1.0 or length > longest or n > spare + v * width + u:
                continue
            if dz * dz <= gate2 * (now[3, u] + before[3, u]):
                pieces = min(int(np.sqrt(length)) + 1, 8)
                for piece in range(1, pieces):
                    back = np.float32(piece / pieces)
                    c = int(now[0, u] - back * dx) * ny + int(now[1, u] - back * dy)
                    cell[n], point[n, 0], point[n, 1] = c, z - back * dz, -precision
                    n += 1
                    tops[c] = max(tops[c], z - back * dz)
    limit = 4 * gate2  # ± gate around the surface reaches 2 · gate below its highest point
    for k in range(n):
        c = cell[k]
        below = point[k, 0] - tops[c]
        precision = abs(point[k, 1])  # below 0: a point between two pixels
        if below * below * precision <= limit:
            weights[c] += precision
            totals[c] += precision * below
            if point[k, 1] > 0:
                counts[c] += 1


@kernel
def fuse(frame: DepthFrame, first: tuple[int, int], o: Options, now: float, cells: Cells) -> int:
    """Fuse one image's heights, taken at ``now`` [s], into the map's buffers; returns how many cells it reached.

    The ``due`` of cells that were given another height is set to -1, see :func:`judge`.
    """
    top, weight, total = frame.top, frame.weight, frame.total
    height, variance, seen, doubted, due = cells.height, cells.variance, cells.seen, cells.doubted, cells.due
    nx, ny = top.shape
    least = o.base_noise * o.base_noise
    gate = o.gate * o.gate
    reached = 0
    for ix in range(nx):
        i = (first[0] + ix) % nx
        for iy in range(ny):
            if weight[ix, iy] == 0.0:
                continue
            reached += 1
            j = (first[1] + iy) % ny
            z = top[ix, iy] + total[ix, iy] / weight[ix, iy]
            noise = max(1.0 / weight[ix, iy], least)  # neighbouring pixels err together
            replace = np.isnan(height[i, j])
            if not replace:
                prior = variance[i, j] + o.drift * max(now - seen[i, j], 0.0)
                error = z - height[i, j]
                if error * error <= gate * (prior + noise):
                    gain = prior / (prior + noise) if prior < np.inf else 1.0
                    height[i, j] += gain * error
                    variance[i, j] = max(gain * noise, least)
                    seen[i, j] = now
                    doubted[i, j] = np.inf
                elif error > 0.0 or noise < _FAR_MORE_CERTAIN * prior:
                    replace = True
                else:
                    doubted[i, j] = min(doubted[i, j], now)
                    replace = now - doubted[i, j] >= o.replace_after
            if replace:
                height[i, j] = z
                variance[i, j] = noise
                seen[i, j] = now
                doubted[i, j] = np.inf
                due[i, j] = -1.0
    return reached


@kernel
def judge(
    pixels: Array32,
    rotation: Array,
    translation: Array,
    size: tuple[int, int],
    first: tuple[int, int],
    o: Options,
    cells: Cells,
) -> None:
    """Count for each known cell the pixels that hit it, and the pixels expected if it had been there throughout.

    Range noise throws points over an edge, into cells that are empty; few of the pixels expected there ever hit them. A
    horizontal patch of area A at optical depth Z, seen from h above it, should get f_x · f_y · A · h / Z³ pixels. The
    counts start again for a cell that was given another height in this image, which a negative ``due`` marks.

    ``pixels`` (nx, ny) are those of the image's :class:`DepthFrame`; ``rotation`` (3, 3) and ``translation`` (3,) [m]
    lead from the optical frame to the world; ``size`` is the image's height and width, ``first`` the map's first cell.
    """
    height, hits, due = cells.height, cells.hits, cells.due
    nx, ny = pixels.shape
    rows, columns = size
    density = o.fx * o.fy * o.resolution * o.resolution
    for ix in range(nx):
        i = (first[0] + ix) % nx
        x = (first[0] + ix + 0.5) * o.resolution - translation[0]
        for iy in range(ny):
            j = (first[1] + iy) % ny
            if np.isnan(height[i, j]):
                continue
            y = (first[1] + iy + 0.5) * o.resolution - translation[1]
            z = height[i, j] - translation[2]
            depth = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
            if due[i, j] < 0.0:
                hits[i, j] = due[i, j] = 0.0
            if depth < o.min_range or depth > o.max_range or z >= 0.0:
                continue
            u = o.cx + o.fx * (rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z) / depth
            v = o.cy + o.fy * (rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z) / depth
            if u < _BORDER or u > columns - 1 - _BORDER or v < _BORDER or v > rows - 1 - _BORDER:
                continue
            hits[i, j] += pixels[ix, iy]
            due[i, j] += density * -z / (depth * depth * depth)
            if due[i, j] > _MOST_DUE:
                keep = _MOST_DUE / due[i, j]
                hits[i, j] *= keep
                due[i, j] *= keep


@kernel
def supported(cells: Cells, share: float) -> Array32:
    """Return the heights (nx, ny) [m] of cells that this share of the expected pixels hit; NaN for the others."""
    height, hits, due = cells.height, cells.hits, cells.due
    out = height.copy()
    nx, ny = height.shape
    for i in range(nx):
        for j in range(ny):
            if due[i, j] >= _LEAST_DUE and hits[i, j] < share * due[i, j]:
                out[i, j] = np.nan
    return out
