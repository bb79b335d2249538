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
    """The m primitives of a scene that carry feet, those first that stand upright, turned by a yaw alone.

    ``numbers`` (m,) in the scene; ``upright`` (k, 9) kind, x, y, z, cosine and sine of yaw, and the three sizes of the
    first k; ``turned`` (m - k, 16) kind, x, y, z, three sizes, and the rotation row by row of the others; ``ground``
    (m,) whether a foot may stand there.
    """

    numbers: NDArray[np.int64]
    upright: Array
    turned: Array
    ground: NDArray[np.bool_]


def carriers_of(scene: Scene, carries: NDArray[np.bool_], ground: NDArray[np.bool_]) -> Carriers:
    """The carriers among a scene's primitives.

    Args:
        scene: its primitives.
        carries: (n,) which of them.
        ground: (n,) which of them a foot may stand on.
    """
    stands = scene.rotations[:, 2, 2] == 1.0
    first, others = np.flatnonzero(carries & stands), np.flatnonzero(carries & ~stands)
    numbers, r = np.concatenate([first, others]), scene.rotations
    upright = np.column_stack(
        [scene.kinds[first], scene.positions[first], r[first, 0, 0], r[first, 1, 0], scene.sizes[first]]
    ).reshape(len(first), 9)
    turned = np.column_stack(
        [scene.kinds[others], scene.positions[others], scene.sizes[others], r[others].reshape(len(others), 9)]
    ).reshape(len(others), 16)
    return Carriers(numbers, upright, turned, ground[numbers])


@kernel
def highest_carrier(upright: Array, turned: Array, x: float, y: float, below: float) -> tuple[float, int]:
    """Highest face of a carrier over (x, y) that is lower than ``below``, and its row; -inf and -1 where none is.

    It takes the two tables of :class:`Carriers` by themselves: to hand over all of it costs more than to look.
    """
    best, which = -np.inf, -1
    for k in range(upright.shape[0]):
        kind, px, py, pz, c, s, sx, sy, sz = upright[k]
        u = c * (x - px) + s * (y - py)
        v = c * (y - py) - s * (x - px)
        top = pz + sz
        if kind == CYLINDER:
            over = u * u + v * v <= (sx + _SLIT_M) * (sx + _SLIT_M)
        elif kind == PLANE:
            over = (sx == 0.0 or abs(u) <= sx) and (sy == 0.0 or abs(v) <= sy)
        else:
            over = abs(u) <= sx + _SLIT_M and abs(v) <= sy + _SLIT_M
            if kind == WEDGE:
                top = pz + sz * u / sx
        if over and best < top < below:
            best, which = top, k
    if turned.shape[0] == 0:
        return best, which
    return _highest_turned(turned, x, y, below, best, which, upright.shape[0])


@kernel
def _highest_turned(
    turned: Array, x: float, y: float, below: float, best: float, which: int, first: int
) -> tuple[float, int]:
    """Go on with the carriers that are turned anyhow, whose rows begin at ``first``."""
    for k in range(turned.shape[0]):
        top, _ = _met(turned, k, x, y)
        if best < top < below:
            best, which = top, first + k
    return best, which


@kernel
def _met(turned: Array, k: int, x: float, y: float) -> tuple[float, float]:
    """Height over (x, y), -inf beside it, and upward share of the normal of a carrier that is turned anyhow.

    By a ray straight down, in the carrier's frame.
    """
    kind, px, py, pz, sx, sy, sz, r00, r01, r02, r10, r11, r12, r20, r21, r22 = turned[k]
    rise = sx + sy + sz + _ABOVE_M
    dx, dy = x - px, y - py
    o = (
        r00 * dx + r10 * dy + r20 * rise,
        r01 * dx + r11 * dy + r21 * rise,
        r02 * dx + r12 * dy + r22 * rise,
    )
    size = (sx, sy, sz)
    t = meet(int(kind), size, o, (-r20, -r21, -r22))
    if t == np.inf:
        return -np.inf, 1.0
    nx, ny, nz = face_normal(int(kind), size, (o[0] - t * r20, o[1] - t * r21, o[2] - t * r22))
    return pz + rise - t, r20 * nx + r21 * ny + r22 * nz


@kernel
def _upward(carriers: Carriers, row: int, x: float, y: float) -> float:
    """Upward share of the normal of a carrier's face over (x, y)."""
    count = carriers.upright.shape[0]
    if row >= count:
        return _met(carriers.turned, row - count, x, y)[1]
    sx, sz = carriers.upright[row, 6], carriers.upright[row, 8]
    return sx / np.sqrt(sx * sx + sz * sz) if carriers.upright[row, 0] == WEDGE else 1.0


@kernel
def highest_faces(
    carriers: Carriers, x: Array, y: Array, below: float, heights: Array, rows: NDArray[np.int64]
) -> None:
    """:func:`highest_carrier` over n places: fills heights (n,) and rows (n,)."""
    upright, turned = carriers.upright, carriers.turned
    for n in range(x.size):
        heights[n], rows[n] = highest_carrier(upright, turned, x[n], y[n], below)


@kernel
def faces_below(carriers: Carriers, points: Array, reach: float, heights: Array, stand: NDArray[np.bool_]) -> None:
    """The face that each point is on, or hangs over: the highest less than ``reach`` above it.

    Fills heights (n,) [m], -inf where none is, and stand (n,): whether it is ground, and no steeper than a top may be.
    """
    for n in range(points.shape[0]):
        x, y, z = points[n]
        best, which = highest_carrier(carriers.upright, carriers.turned, x, y, z + reach)
        heights[n] = best
        stand[n] = which >= 0 and carriers.ground[which] and _upward(carriers, which, x, y) > TOP
