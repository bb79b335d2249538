"""The ray caster's inner loops: where a ray meets each kind of primitive, and the normal there.

All in a primitive's own frame. Convex kinds are intersections of intervals: the stretch of the ray inside each bounding
surface; the ray enters where the last stretch begins. A ray that starts inside a solid does not see it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool.sim.worlds.rays import PixelRays, pixel_ray
from legtool_runtime.cache import kernel

Array = NDArray[np.float64]

#: Kinds of primitives, and what ``size`` means for each (half lengths as MuJoCo has them).
PLANE, BOX, WEDGE, CYLINDER, SPHERE, SEMISPHERE, CAPSULE, TUBE = range(8)

_TINY = 1e-12


@kernel
def _slab(o: float, d: float, half: float, near: float, far: float) -> tuple[float, float]:
    """Narrow the stretch [near, far] to |o + t d| ≤ half."""
    if abs(d) < _TINY:
        return (near, far) if abs(o) <= half else (1.0, -1.0)
    inverse = 1.0 / d
    a = (-half - o) * inverse
    b = (half - o) * inverse
    return max(near, min(a, b)), min(far, max(a, b))


@kernel
def _below(value: float, slope: float, near: float, far: float) -> tuple[float, float]:
    """Narrow the stretch to value + t slope ≤ 0."""
    if abs(slope) < _TINY:
        return (near, far) if value <= 0.0 else (1.0, -1.0)
    t = -value / slope
    return (near, min(far, t)) if slope > 0.0 else (max(near, t), far)


@kernel
def _roots(a: float, half_b: float, c: float) -> tuple[float, float]:
    """Both roots of a t² + 2 half_b t + c, an empty stretch where there are none."""
    discriminant = half_b * half_b - a * c
    if discriminant < 0.0:
        return 1.0, -1.0
    if a < _TINY:
        return (-np.inf, np.inf) if c <= 0.0 else (1.0, -1.0)
    root = np.sqrt(discriminant)
    return (-half_b - root) / a, (-half_b + root) / a


@kernel
def meet(kind: int, size: Any, o: Any, d: Any) -> float:
    """First t > 0 at which o + t d meets a primitive; inf where it does not.

    Args:
        kind: one of the kinds above.
        size: its three sizes [m].
        o, d: the ray in the primitive's frame, as triples.
    """
    inf = np.inf
    ox, oy, oz = o
    dx, dy, dz = d
    sx, sy, sz = size
    if kind == BOX:
        near, far = _slab(ox, dx, sx, -inf, inf)
        near, far = _slab(oy, dy, sy, near, far)
        near, far = _slab(oz, dz, sz, near, far)
        return near if 0.0 < near <= far else inf
    if kind == PLANE:
        if oz <= 0.0 or dz >= 0.0:
            return inf
        t = -oz / dz
        if (sx > 0.0 and abs(ox + t * dx) > sx) or (sy > 0.0 and abs(oy + t * dy) > sy):
            return inf
        return t
    if kind == CYLINDER:
        near, far = _roots(dx * dx + dy * dy, ox * dx + oy * dy, ox * ox + oy * oy - sx * sx)
        near, far = _slab(oz, dz, sz, near, far)
        return near if 0.0 < near <= far else inf
    if kind == SPHERE:
        near, far = _roots(
            dx * dx + dy * dy + dz * dz, ox * dx + oy * dy + oz * dz, ox * ox + oy * oy + oz * oz - sx * sx
        )
        return near if 0.0 < near <= far else inf
    if kind == SEMISPHERE:
        near, far = _roots(
            dx * dx + dy * dy + dz * dz, ox * dx + oy * dy + oz * dz, ox * ox + oy * oy + oz * oz - sx * sx
        )
        near, far = _below(-oz, -dz, near, far)
        return near if 0.0 < near <= far else inf
    if kind == WEDGE:
        near, far = _slab(ox, dx, sx, -inf, inf)
        near, far = _slab(oy, dy, sy, near, far)
        near, far = _below(-oz - sz, -dz, near, far)
        near, far = _below(sx * oz - sz * ox, sx * dz - sz * dx, near, far)
        return near if 0.0 < near <= far else inf
    if kind == CAPSULE:
        return _capsule(ox, oy, oz, dx, dy, dz, sx, sz)
    return _tube(ox, oy, oz, dx, dy, dz, sx, sy, sz)


@kernel
def _capsule(ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, radius: float, half: float) -> float:
    near, far = _roots(dx * dx + dy * dy, ox * dx + oy * dy, ox * ox + oy * oy - radius * radius)
    if near > far:
        return np.inf
    z = oz + near * dz
    if near > -np.inf and abs(z) <= half:
        return near if near > 0.0 else np.inf
    # Through an end: the ball that the ray comes to first.
    towards = z if near > -np.inf else -dz
    middle = half if towards > 0.0 else -half
    height = oz - middle
    near, far = _roots(
        dx * dx + dy * dy + dz * dz,
        ox * dx + oy * dy + height * dz,
        ox * ox + oy * oy + height * height - radius * radius,
    )
    return near if 0.0 < near <= far else np.inf


@kernel
def _tube(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, outer: float, inner: float, half: float
) -> float:
    """Open at both ends: outside, the ring of its wall at an end, or the inside seen through an end."""
    a, half_b, c = dx * dx + dy * dy, ox * dx + oy * dy, ox * ox + oy * oy
    near, far = _roots(a, half_b, c - outer * outer)
    near, far = _slab(oz, dz, half, near, far)
    if near > far:
        return np.inf
    x, y = ox + near * dx, oy + near * dy
    if near > 0.0 and x * x + y * y >= inner * inner:
        return near
    near, far = _roots(a, half_b, c - inner * inner)
    if near > far or not far > 0.0 or far == np.inf:
        return np.inf
    return far if abs(oz + far * dz) <= half else np.inf


@kernel
def face_normal(kind: int, size: Any, p: Any) -> tuple[float, float, float]:
    """Outward unit normal at a point of a primitive's surface, in the primitive's frame."""
    x, y, z = p
    sx, sy, sz = size
    if kind == PLANE:
        return 0.0, 0.0, 1.0
    if kind == BOX:
        ax, ay, az = sx - abs(x), sy - abs(y), sz - abs(z)
        if az <= ax and az <= ay:
            return 0.0, 0.0, np.sign(z)
        return (np.sign(x), 0.0, 0.0) if ax <= ay else (0.0, np.sign(y), 0.0)
    if kind == WEDGE:
        length = np.sqrt(sx * sx + sz * sz)
        slope = (sz * x - sx * z) / length
        back, side, bottom = sx - x, sy - abs(y), z + sz
        if slope <= back and slope <= side and slope <= bottom:
            return -sz / length, 0.0, sx / length
        if bottom <= back and bottom <= side:
            return 0.0, 0.0, -1.0
        return (1.0, 0.0, 0.0) if back <= side else (0.0, np.sign(y), 0.0)
    radial = np.sqrt(x * x + y * y)
    if kind == CYLINDER:
        if sz - abs(z) <= sx - radial:
            return 0.0, 0.0, np.sign(z)
        return x / radial, y / radial, 0.0
    if kind == SPHERE:
        return x / sx, y / sx, z / sx
    if kind == SEMISPHERE:
        if z <= sx - np.sqrt(x * x + y * y + z * z):
            return 0.0, 0.0, -1.0
        return x / sx, y / sx, z / sx
    if kind == CAPSULE:
        height = z - min(max(z, -sz), sz)
        return x / sx, y / sx, height / sx
    ring, outside, inside = sz - abs(z), abs(sx - radial), abs(radial - sy)
    if ring <= outside and ring <= inside:
        return 0.0, 0.0, np.sign(z)
    if outside <= inside:
        return x / radial, y / radial, 0.0
    return -x / radial, -y / radial, 0.0


@kernel
def cast_primitive(
    geom: int,
    kind: int,
    size: Array,
    origin: Array,
    turn: Array,
    intrinsics: Array,
    rectangle: Any,
    nearest: float,
    depth: Array,
    geoms: NDArray[np.int32],
) -> None:
    """Draw one primitive into ``depth`` (h, w) and ``geoms``, inside its screen rectangle, where it is nearest.

    Args:
        geom: number to write.
        kind, size: the primitive.
        origin: (3,) the camera in the primitive's frame.
        turn: (3, 3) optical frame to the primitive's frame.
        intrinsics: fx, fy, cx, cy; it is called for each primitive, and an array is handed over faster than a view.
        rectangle: first row, end row, first column, end column.
        nearest: no part of it is closer than this depth [m].
    """
    fx, fy, cx, cy = intrinsics
    v0, v1, u0, u1 = rectangle
    sizes = (size[0], size[1], size[2])
    o = (origin[0], origin[1], origin[2])
    for v in range(v0, v1):
        # The row's share of each ray, once for all of its pixels.
        b = (v - cy) / fy
        rx = turn[0, 1] * b + turn[0, 2]
        ry = turn[1, 1] * b + turn[1, 2]
        rz = turn[2, 1] * b + turn[2, 2]
        for u in range(u0, u1):
            if depth[v, u] <= nearest:
                continue
            a = (u - cx) / fx
            t = meet(kind, sizes, o, (turn[0, 0] * a + rx, turn[1, 0] * a + ry, turn[2, 0] * a + rz))
            if t < depth[v, u]:
                depth[v, u] = t
                geoms[v, u] = geom


@kernel
def primitive_normals(
    kinds: NDArray[np.int64],
    sizes: Array,
    origins: Array,
    turns: Array,
    rotations: Array,
    view: PixelRays,
    depth: Array,
    geoms: NDArray[np.int32],
    normals: NDArray[np.float32],
) -> None:
    """World normals (h, w, 3) of the pixels that show a primitive."""
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            g = geoms[v, u]
            if g < 0 or g >= kinds.size:
                continue
            t, r = depth[v, u], rotations[g]
            dx, dy, dz = pixel_ray(view, turns[g], u, v)
            x, y, z = face_normal(
                kinds[g],
                (sizes[g, 0], sizes[g, 1], sizes[g, 2]),
                (origins[g, 0] + t * dx, origins[g, 1] + t * dy, origins[g, 2] + t * dz),
            )
            for k in range(3):
                normals[v, u, k] = r[k, 0] * x + r[k, 1] * y + r[k, 2] * z
