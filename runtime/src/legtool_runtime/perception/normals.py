"""Surface normals from depth gradients (QuadPiPS, equations 5-9)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception.camera import Camera, Depth

Floats = NDArray[np.float32]

#: Cosine of the steepest incidence that is told apart from a jump in depth: a surface at 87° to the ray.
_GRAZING = float(np.cos(np.deg2rad(87.0)))
#: Share of a sum of squares that float32 loses: windows that fit better than this are equal.
_ROUNDING = np.float32(4e-6)


def normals(depth: Depth, camera: Camera, *, reach: int = 0) -> Floats:
    """Unit normals that point to the camera.

    With a = (u - cx)/fx and b = (v - cy)/fy the cross product of equation 8, both derivatives taken by equation 6 (with
    v - v₀ where y - y₀ is printed, and a focal length for each axis), comes down to

        n ∝ (fx z_u, fy z_v, -(z + a fx z_u + b fy z_v)).

    The derivatives are taken of 1/z, which on a plane is linear in u and v: the normal of a plane is exact.

    Args:
        depth: (height, width) [m], NaN where there is no return.
        camera: the camera that took it.
        reach: 0 for equation 7's differences between neighbours, which noise of a tenth of a pixel's width spoils.
            Otherwise slopes are least squares over windows of 2 · reach + 1 pixels: the one around the pixel or one of
            four beside it, whichever is flattest, so that edges stay sharp.

    Returns:
        (height, width, 3) optical frame. NaN where a needed return is missing (with reach 0 that of the pixel or its
        neighbour to the right or below), and where the surface is seen at less than 3°, as a jump in depth looks.

    Raises:
        PerceptionError: a window larger than the image.
    """
    if not 0 <= reach < min(depth.shape) // 4:
        raise PerceptionError(
            f"normals: reach {reach} for an image of {depth.shape}, expected 0 to {min(depth.shape) // 4 - 1}"
        )
    out = np.empty((*depth.shape, 3), dtype=np.float32)
    slopes = np.empty((2, *depth.shape), dtype=np.float32)
    if reach:
        fits = np.empty((3, *depth.shape), dtype=np.float32)
        _fit_windows(depth, reach, fits)
        _flattest(fits, reach, slopes)
    else:
        _differences(depth, slopes)
    _from_slopes(depth, slopes, camera.intrinsics, _GRAZING, out)
    return out


@kernel
def _differences(depth: Depth, slopes: Floats) -> None:
    """Slopes of 1/z over u and v (2, h, w), by equation 7's forward differences."""
    height, width = depth.shape
    one = np.float32(1.0)
    for v in range(height - 1):
        for u in range(width - 1):
            inverse = one / depth[v, u]
            slopes[0, v, u] = one / depth[v, u + 1] - inverse
            slopes[1, v, u] = one / depth[v + 1, u] - inverse
        slopes[0, v, width - 1] = np.float32(np.nan)
    slopes[0, height - 1] = np.float32(np.nan)


@kernel
def _fit_windows(depth: Depth, reach: int, fits: Floats) -> None:
    """Least-squares slopes of 1/z over u and v in the window around each pixel, and the fit's squared error."""
    height, width = depth.shape
    one = np.float32(1.0)
    size = 2 * reach + 1
    per_pixel = one / np.float32(size * size)
    spread = 0
    for k in range(-reach, reach + 1):
        spread += size * k * k
    per_spread = one / np.float32(spread)
    shift, inner = np.uint64(reach), np.uint64(width - 2 * reach)
    sums = np.empty((4, width), np.float32)
    inverse = np.empty((size, width), np.float32)  # the window's rows, row v in v modulo size
    total, slope, square = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    fits[:, :reach], fits[:, height - reach :] = np.nan, np.nan
    fits[:, :, :reach], fits[:, :, width - reach :] = np.nan, np.nan
    for v in range(height):
        row = v % size
        for u in range(width):
            inverse[row, u] = one / depth[v, u]
        middle = v - reach
        if middle < reach:
            continue
        total[:], slope[:], square[:] = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for k in range(-reach, reach + 1):
            weight, row = np.float32(k), (middle + k) % size
            for u in range(width):
                q = inverse[row, u]
                total[u] += q
                slope[u] += weight * q
                square[u] += q * q
        sums[:] = np.float32(0.0)
        for k in range(size):
            weight, ahead = np.float32(k - reach), np.uint64(k)
            for u in range(inner):  # unsigned: no index is negative, and the compiler takes eight pixels at a time
                sums[0, u] += total[u + ahead]
                sums[1, u] += weight * total[u + ahead]
                sums[2, u] += slope[u + ahead]
                sums[3, u] += square[u + ahead]
        for u in range(inner):
            sum_q, sum_u, sum_v, sum_qq = sums[0, u], sums[1, u], sums[2, u], sums[3, u]
            error = sum_qq - sum_q * sum_q * per_pixel - (sum_u * sum_u + sum_v * sum_v) * per_spread
            least = _ROUNDING * sum_qq
            fits[0, middle, u + shift] = sum_u * per_spread
            fits[1, middle, u + shift] = sum_v * per_spread
            fits[2, middle, u + shift] = error if error > least else least


@kernel
def _flattest(fits: Floats, reach: int, slopes: Floats) -> None:
    """For each pixel the slopes of the window that fits best: that around it, or one of the four it is a corner of.

    Its own has the least noise: another must fit twice as well. No window fits where all lack a return.
    """
    height, width = fits.shape[1:]
    half, worst = np.float32(0.5), np.float32(np.inf)
    best, along_u, along_v = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    shift, across = np.uint64(reach), np.uint64(width - reach)
    for v in range(height):
        for u in range(width):
            error = half * fits[2, v, u]
            best[u] = error if error < worst else worst
            along_u[u], along_v[u] = fits[0, v, u], fits[1, v, u]
        for side in range(2):
            other = v - reach if side == 0 else v + reach
            if other < 0 or other >= height:
                continue
            row = np.uint64(other)
            for u in range(across):  # the window to the right, then to the left
                error = fits[2, row, u + shift]
                better = error < best[u]
                best[u] = error if better else best[u]
                along_u[u] = fits[0, row, u + shift] if better else along_u[u]
                along_v[u] = fits[1, row, u + shift] if better else along_v[u]
            for u in range(across):
                error = fits[2, row, u]
                better = error < best[u + shift]
                best[u + shift] = error if better else best[u + shift]
                along_u[u + shift] = fits[0, row, u] if better else along_u[u + shift]
                along_v[u + shift] = fits[1, row, u] if better else along_v[u + shift]
        for u in range(width):
            slopes[0, v, u], slopes[1, v, u] = along_u[u], along_v[u]


@kernel
def _from_slopes(depth: Depth, slopes: Floats, intrinsics: Floats, grazing: float, out: Floats) -> None:
    """Equations 6, 8 and 9, with z_u = -z² ∂(1/z)/∂u; the factor z is common to all components and left out."""
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    one, steepest = np.float32(1.0), np.float32(grazing)
    a = (np.arange(width).astype(np.float32) - cx) / fx
    row = np.empty((3, width), np.float32)
    for v in range(height):
        b = (np.float32(v) - cy) / fy
        for u in range(width):
            z = depth[v, u]
            x, y = -fx * z * slopes[0, v, u], -fy * z * slopes[1, v, u]
            along = one + a[u] * x + b * y
            length = np.sqrt(x * x + y * y + along * along)
            # n·p = -z for the point p = z (a, b, 1): the cosine of incidence is 1 / (|n| |(a, b, 1)|).
            ray = np.sqrt(one + a[u] * a[u] + b * b)
            scale = one / length if length * ray * steepest < one else np.float32(np.nan)
            row[0, u], row[1, u], row[2, u] = x * scale, y * scale, -along * scale
        for u in range(width):
            out[v, u, 0], out[v, u, 1], out[v, u, 2] = row[0, u], row[1, u], row[2, u]
