"""The tuple of ViTAL (section II): all that footholds are judged by, checked once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, InitVar, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.errors import MapError, StateError
from legtool_runtime.foothold.gait import Gait, checked_twist
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE
from legtool_runtime.robot import LEGS

Array32 = NDArray[np.float32]
#: The farthest that a nominal foothold may lie from the hip [m].
_FARTHEST_M = 2.0


@dataclass(frozen=True, eq=False)
class Tuple:
    """T = (H, z_h, v_b, α) of one leg, where its map lies, and which leg it is.

    Built once, it is handed to the criteria, to foothold selection and to the networks alike. ``resolution_m`` is the
    side of the map's cells; it is not kept, for anything but 0.02 m is refused.

    Attributes:
        heights: (33, 33) H [m], float32, a copy; indexed [ix, iy], x forward and y left in the horizontal frame at
            touchdown; NaN where unknown.
        base_twist: (6,) v_b, linear then angular velocity, horizontal frame [m/s, rad/s].
        gait: α.
        leg: index into FL, FR, RL, RR.
        hip_height: z_h of the abduction axis at touchdown [m], in the vertical frame of the heights; None where
            footholds are counted over hip heights (VPA).
        nominal: (2,) the map's centre from below the hip at touchdown, horizontal frame [m], where the map lies around
            a nominal foothold (VFA); None: it lies below the hip (VPA).

    Raises:
        MapError: the map has another size or resolution, or an infinite height.
        StateError: no such leg, or a twist, nominal foothold or hip height that cannot be.
    """

    heights: Array32
    _: KW_ONLY
    base_twist: Sequence[float]
    gait: Gait
    leg: int
    hip_height: float | None = None
    nominal: Sequence[float] | None = None
    resolution_m: InitVar[float] = RESOLUTION_M

    def __post_init__(self, resolution_m: float) -> None:
        keep: dict[str, Any] = {"heights": _heights(self.heights, resolution_m)}
        if self.leg not in range(4):
            raise StateError(f"leg is {self.leg!r}, expected 0 to 3 for {', '.join(LEGS)}")
        keep["base_twist"] = checked_twist(self.base_twist)
        if self.hip_height is not None:
            if not math.isfinite(self.hip_height):
                raise StateError(f"hip height is {self.hip_height}, expected a finite number of metres")
            keep["hip_height"] = float(self.hip_height)
        if self.nominal is not None:
            keep["nominal"] = x, y = float(self.nominal[0]), float(self.nominal[1])
            if not math.hypot(x, y) < _FARTHEST_M:
                raise StateError(f"nominal foothold {(x, y)} m from the hip: expected finite, within {_FARTHEST_M:g} m")
        for name, value in keep.items():
            object.__setattr__(self, name, value)

    @property
    def hip(self) -> tuple[float, float]:
        """(2,) where the hip is above at touchdown, from the map's centre [m]."""
        return (0.0, 0.0) if self.nominal is None else (-self.nominal[0], -self.nominal[1])

    @property
    def ground(self) -> float:
        """Height below the hip [m], of the nearest cell where the hip is not above the map; NaN where unknown."""
        i, j = (min(max(round(x / RESOLUTION_M) + SIZE // 2, 0), SIZE - 1) for x in self.hip)
        return float(self.heights[i, j])


def _heights(heights: ArrayLike, resolution_m: float) -> Array32:
    h = np.asarray(heights)
    if h.shape != (SIZE, SIZE) or abs(resolution_m - RESOLUTION_M) > 1e-6:
        raise MapError(
            f"heightmap of shape {h.shape} at {resolution_m:g} m: expected ({SIZE}, {SIZE}) at {RESOLUTION_M} m; "
            "cut one with extract_heightmap, which resamples if asked to"
        )
    if h.dtype.kind not in "fiu":
        raise MapError(f"heightmap of {h.dtype}: expected numbers [m], NaN where unknown")
    h = np.array(h, dtype=np.float32, order="C")
    if np.isinf(h).any():
        raise MapError("heightmap: a height is infinite; mark unknown cells by NaN")
    return h
