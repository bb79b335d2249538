"""The ray through a pixel, which every loop over an image shares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.perception.camera import Camera

Array = NDArray[np.float64]


class PixelRays(NamedTuple):
    """A camera at its place: intrinsics [pixel]; ``turn`` (3, 3) and ``position`` (3,), optical frame to world."""

    fx: float
    fy: float
    cx: float
    cy: float
    turn: Array
    position: Array


def view_of(camera: Camera, pose: ArrayLike) -> PixelRays:
    """The view of a camera whose (4, 4) optical frame to world is ``pose``."""
    pose = np.asarray(pose, dtype=float)
    turn, position = np.ascontiguousarray(pose[:3, :3]), np.ascontiguousarray(pose[:3, 3])
    return PixelRays(float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy), turn, position)


@kernel
def pixel_ray(view: PixelRays, turn: Array, u: int, v: int) -> tuple[float, float, float]:
    """Direction of the ray through pixel (u, v), of length 1 along the optical axis, turned by ``turn`` (3, 3)."""
    a, b = (u - view.cx) / view.fx, (v - view.cy) / view.fy
    return (
        turn[0, 0] * a + turn[0, 1] * b + turn[0, 2],
        turn[1, 0] * a + turn[1, 1] * b + turn[1, 2],
        turn[2, 0] * a + turn[2, 1] * b + turn[2, 2],
    )
