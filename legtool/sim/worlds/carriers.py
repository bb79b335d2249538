"""What carries a foot where: the upward faces of floors, boxes, ramps and standing cylinders, met from above."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.sim.worlds.raycast import Scene
from legtool.sim.worlds.raycast_kernels import CYLINDER, PLANE, WEDGE, face_normal, meet
from legtool_runtime.cache import kernel

Array = NDArray[np.float64]

#: A face is a top, which a foot may stand on, where its normal's upward share is above this (60°).
TOP = 0.5
#: Two boxes that share an edge leave no slit between them: faces reach this much farther [m].
_SLIT_M = 1e-9
#: A ray from above starts this far above a primitive [m].
_ABOVE_M = 1.0


class Carriers(NamedTuple):
    """The m primitives of a scene that carry feet.

    ``numbers`` (m,) in the scene; ``kinds`` (m,); ``upright`` (m,) turned by a yaw alone; ``positions`` (m, 3),
    ``rotations`` (m, 3, 3), ``sizes`` (m, 3) as the scene has them; ``ground`` (m,) whether a foot may stand there.
    """

    numbers: NDArray[np.int64]
    kinds: NDArray[np.int64]
    upright: NDArray[np.bool_]
    positions: Array
    rotations: Array
    sizes: Array
    ground: NDArray[np.bool_]


def carriers_of(scene: Scene, carries: NDArray[np.bool_], ground: NDArray[np.bool_]) -> Carriers:
    """The carriers among a scene's primitives.

    Args:
        scene: its primitives.
        carries: (n,) which of them.
        ground: (n,) which of them a foot may stand on.
    """
    which = np.flatnonzero(carries)
    rotations = np.ascontiguousarray(scene.rotations[which])
    return Carriers(
        which, scene.kinds[which], rotations[:, 2, 2] == 1.0, scene.positions[which], rotations, scene.sizes[which],
        np.ascontiguousarray(ground[which]),
    )  # fmt: skip


@kernel
def _face(carriers: Carriers, k: int, x: float, y: float) -> tuple[float, float]:
    """Height of carrier ``k``'s face over (x, y), -inf beside it, and the upward share of the face's normal."""
    px, py, pz = carriers.positions[k]
    sx, sy, sz = carriers.sizes[k]
    r = carriers.rotations[k]
    kind = carriers.kinds[k]
    if carriers.upright[k]:
        c, s = r[0, 0], r[1, 0]
        u = c * (x - px) + s * (y - py)
        v = c * (y - py) - s * (x - px)
        if kind == CYLINDER:
            over = u * u + v * v <= (sx + _SLIT_M) * (sx + _SLIT_M)
        elif kind == PLANE:
            over = (sx == 0.0 or abs(u) <= sx + _SLIT_M) and (sy == 0.0 or abs(v) <= sy + _SLIT_M)
        else:
            over = abs(u) <= sx + _SLIT_M and abs(v) <= sy + _SLIT_M
        if not over:
            return -np.inf, 1.0
        if kind == WEDGE:
            return pz + sz * u / sx, sx / np.sqrt(sx * sx + sz * sz)
        return pz + sz, 1.0
    # Any other way up: a ray straight down, in the primitive's frame.
    rise = sx + sy + sz + _ABOVE_M
    dx, dy = x - px, y - py
    o = (
        r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * rise,
        r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * rise,
        r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * rise,
    )
    d = (-r[2, 0], -r[2, 1], -r[2, 2])
    size = (sx, sy, sz)
    t = meet(kind, size, o, d)
    if t == np.inf:
        return -np.inf, 1.0
    nx, ny, nz = face_normal(kind, size, (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]))
    return pz + rise - t, r[2, 0] * nx + r[2, 1] * ny + r[2, 2] * nz


@kernel
def highest_carrier(carriers: Carriers, x: float, y: float, below: float) -> tuple[float, int]:
    """Highest face of a carrier over (x, y) that is lower than ``below``, and its row; -inf and -1 where none is."""
    best, which = -np.inf, -1
    for k in range(carriers.kinds.size):
        top, _ = _face(carriers, k, x, y)
        if best < top < below:
            best, which = top, k
    return best, which


@kernel
def highest_faces(
    carriers: Carriers, x: Array, y: Array, below: float, heights: Array, rows: NDArray[np.int64]
) -> None:
    """:func:`highest_carrier` over n places: fills heights (n,) and rows (n,)."""
    for n in range(x.size):
        heights[n], rows[n] = highest_carrier(carriers, x[n], y[n], below)


@kernel
def faces_below(carriers: Carriers, points: Array, reach: float, heights: Array, stand: NDArray[np.bool_]) -> None:
    """The face that each point is on, or hangs over: the highest at most ``reach`` above it.

    Fills heights (n,) [m], -inf where none is, and stand (n,): whether it is ground, and no steeper than a top may be.
    """
    for n in range(points.shape[0]):
        best, ground = -np.inf, False
        for k in range(carriers.kinds.size):
            top, up = _face(carriers, k, points[n, 0], points[n, 1])
            if best < top <= points[n, 2] + reach:
                best, ground = top, carriers.ground[k] and up > TOP
        heights[n], stand[n] = best, ground
