"""Pinhole camera: intrinsics that are checked against the image, depth in metres, back-projection.

Optical frame: x right, y down, z forward. Pixel (v, u) is row v, column u, and whole numbers are pixel centres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool_runtime import checks
from legtool_runtime.cache import kernel
from legtool_runtime.checks import Bounds
from legtool_runtime.errors import PerceptionError

Depth = NDArray[np.float32]

#: A depth image whose middle value lies beyond this is not in metres [m].
_FARTHEST_MEDIAN = 100.0
#: A depth image in millimetres whose middle value lies below this is not in millimetres [mm].
_NEAREST_MEDIAN = 50
_BOUNDS = {
    **dict.fromkeys(("width", "height"), Bounds(2, 16384, "pixels")),
    **dict.fromkeys(("fx", "fy"), Bounds(0.0, 1e6, "pixels", above=True)),
    **dict.fromkeys(("cx", "cy"), Bounds(-1e6, 1e6, "pixels")),
}
#: Fields of view that a pinhole camera can have [rad].
_FIELDS_OF_VIEW = (np.deg2rad(5.0), np.deg2rad(160.0))


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a pinhole camera without distortion.

    Attributes:
        width, height: size of its images [pixel].
        fx, fy: focal lengths [pixel].
        cx, cy: the pixel on the optical axis.

    Raises:
        PerceptionError: intrinsics that cannot belong to such an image.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        checks.within("camera", self, _BOUNDS, PerceptionError)
        size = f"a {self.width} × {self.height} image"
        if not (0 <= self.cx <= self.width - 1 and 0 <= self.cy <= self.height - 1):
            raise PerceptionError(
                f"camera: centre ({self.cx:g}, {self.cy:g}) lies outside {size}; "
                "are these the intrinsics of another resolution?"
            )
        for axis, view in zip(("horizontal", "vertical"), self.fields_of_view, strict=True):
            if not _FIELDS_OF_VIEW[0] <= view <= _FIELDS_OF_VIEW[1]:
                raise PerceptionError(
                    f"camera: {size} with focal lengths {self.fx:g}, {self.fy:g} sees {np.rad2deg(view):.1f}° "
                    f"({axis}), expected 5° to 160°; are these the intrinsics of another resolution?"
                )
        if not 0.5 <= self.fx / self.fy <= 2.0:
            raise PerceptionError(f"camera: focal lengths {self.fx:g} and {self.fy:g} differ by more than a factor 2")

    @property
    def fields_of_view(self) -> tuple[float, float]:
        """Horizontal and vertical field of view [rad]."""
        return (
            float(np.arctan((self.cx + 0.5) / self.fx) + np.arctan((self.width - 0.5 - self.cx) / self.fx)),
            float(np.arctan((self.cy + 0.5) / self.fy) + np.arctan((self.height - 0.5 - self.cy) / self.fy)),
        )

    @classmethod
    def from_field_of_view(cls, width: int, height: int, horizontal: float) -> Camera:
        """A camera with square pixels, centred, that sees ``horizontal`` [rad] across its width."""
        focal = 0.5 * width / np.tan(0.5 * horizontal)
        return cls(width, height, float(focal), float(focal), 0.5 * (width - 1), 0.5 * (height - 1))

    @property
    def intrinsics(self) -> NDArray[np.float32]:
        """(4,) fx, fy, cx, cy [pixel], as the kernels take them."""
        return np.array([self.fx, self.fy, self.cx, self.cy], dtype=np.float32)


def as_metres(image: NDArray[Any], camera: Camera) -> Depth:
    """The depth image in metres, checked.

    Args:
        image: (height, width) depth along the optical axis: float32 or float64 in metres, or uint16 in millimetres as
            sensors send it. 0, NaN and infinite values are pixels without return.
        camera: the camera that took it.

    Returns:
        (height, width) float32 [m], pixels without return NaN.

    Raises:
        PerceptionError: another type, shape or unit, negative depth, or no return at all.
    """
    checks.instance("depth image", image, np.ndarray, PerceptionError)
    if image.shape != (camera.height, camera.width):
        raise PerceptionError(
            f"depth image: shape {image.shape}, expected {(camera.height, camera.width)} (height, width) "
            "as the camera's intrinsics say"
        )
    if image.dtype not in (np.float32, np.float64, np.uint16):
        raise PerceptionError(
            f"depth image: type {image.dtype}, expected float32 or float64 in metres, or uint16 in millimetres"
        )
    scale = 0.001 if image.dtype == np.uint16 else 1.0
    depth = np.empty(image.shape, dtype=np.float32)
    negative = _to_metres(np.ascontiguousarray(image), scale, depth)
    if negative:
        raise PerceptionError(f"depth image: {negative} pixels are negative, expected depth in front of the camera")
    sample = depth[::8, ::8]
    seen = sample[sample == sample]
    if not seen.size:
        seen = depth[depth == depth]
    if not seen.size:
        raise PerceptionError(
            f"depth image: none of its {image.size} pixels holds a return (all 0, NaN or infinite); "
            "skip this frame and look at the sensor"
        )
    median = float(np.median(seen))
    if scale == 1.0 and median > _FARTHEST_MEDIAN:
        raise PerceptionError(
            f"depth image: half of it lies beyond {median:.0f} m: these seem to be millimetres; divide by 1000"
        )
    if scale != 1.0 and median < _NEAREST_MEDIAN * scale:
        raise PerceptionError(
            f"depth image: half of its uint16 values lie below {median / scale:.0f}: these seem not to be millimetres"
        )
    return depth


def back_project(depth: Depth, camera: Camera) -> NDArray[np.float32]:
    """Points of a depth image.

    Args:
        depth: (height, width) [m], NaN where there is no return.
        camera: the camera that took it.

    Returns:
        (height, width, 3) optical frame [m], NaN where there is no return.
    """
    x = (np.arange(camera.width, dtype=np.float32) - np.float32(camera.cx)) / np.float32(camera.fx)
    y = (np.arange(camera.height, dtype=np.float32) - np.float32(camera.cy)) / np.float32(camera.fy)
    return np.stack([depth * x, depth * y[:, None], depth], axis=-1)


@kernel
def _to_metres(image: NDArray[Any], scale: float, depth: Depth) -> int:
    """Fill ``depth`` (h, w) with scaled values, NaN where there is no return; how many values are negative."""
    nan, largest = np.float32(np.nan), np.float32(np.finfo(np.float32).max)
    negative = 0
    for v in range(image.shape[0]):
        for u in range(image.shape[1]):
            value = np.float32(image[v, u] * scale)
            depth[v, u] = value if value > np.float32(0.0) and value <= largest else nan
            if value < np.float32(0.0):
                negative += 1
    return negative
