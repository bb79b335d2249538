"""Surface normals from depth gradients (QuadPiPS, equations 5-9)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.perception.camera import Camera, Depth

#: Cosine of the steepest incidence that is told apart from a jump in depth: a surface at 87° to the ray.
_GRAZING = float(np.cos(np.deg2rad(87.0)))


def normals(depth: Depth, camera: Camera) -> NDArray[np.float32]:
    """Unit normals that point to the camera.

    With a = (u - cx)/fx and b = (v - cy)/fy the cross product of equation 8, both derivatives taken by equation 6 (with
    v - v₀ where y - y₀ is printed, and a focal length for each axis), comes down to

        n ∝ (fx z_u, fy z_v, -(z + a fx z_u + b fy z_v)).

    Equation 7's differences are taken in 1/z, which on a plane is linear in u and v: the normal of a plane is exact.

    Args:
        depth: (height, width) [m], NaN where there is no return.
        camera: the camera that took it.

    Returns:
        (height, width, 3) optical frame. NaN where the pixel, or its neighbour to the right or below, has no return,
        and where the surface is seen at less than 3°, which is how a jump in depth looks.
    """
    out = np.empty((*depth.shape, 3), dtype=np.float32)
    _normals(depth, camera.intrinsics, _GRAZING, out)
    return out


@kernel
def _normals(depth: Depth, intrinsics: NDArray[np.float32], grazing: float, out: NDArray[np.float32]) -> None:
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    one, steepest = np.float32(1.0), np.float32(grazing)
    a = (np.arange(width).astype(np.float32) - cx) / fx
    row = np.empty((3, width), np.float32)
    for v in range(height - 1):
        b = (np.float32(v) - cy) / fy
        for u in range(width - 1):
            z = depth[v, u]
            # z_u = -z² ∂(1/z)/∂u = z (z(u+1) - z) / z(u+1); the factor z is common to all components and left out.
            x = fx * (one - z / depth[v, u + 1])
            y = fy * (one - z / depth[v + 1, u])
            depth_part = one + a[u] * x + b * y
            length = np.sqrt(x * x + y * y + depth_part * depth_part)
            # n·p = -z for the point p = z (a, b, 1): the cosine of incidence is 1 / (|n| |(a, b, 1)|).
            ray = np.sqrt(one + a[u] * a[u] + b * b)
            scale = one / length if length * ray * steepest < one else np.float32(np.nan)
            row[0, u] = x * scale
            row[1, u] = y * scale
            row[2, u] = -depth_part * scale
        for u in range(width - 1):
            out[v, u, 0] = row[0, u]
            out[v, u, 1] = row[1, u]
            out[v, u, 2] = row[2, u]
        out[v, width - 1] = np.float32(np.nan)
    out[height - 1] = np.float32(np.nan)
