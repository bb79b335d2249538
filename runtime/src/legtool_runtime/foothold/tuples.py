"""The tuple of ViTAL (section II): all that footholds are judged by, checked once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.errors import MapError, StateError
from legtool_runtime.foothold.gait import Gait, checked_twist
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE
from legtool_runtime.robot import LEGS

Array32 = NDArray[np.float32]
#: The farthest that a nominal foothold may lie from the hip [m], and the trunk's largest roll and pitch [rad].
_FARTHEST_M, _STEEPEST = 2.0, 1.0


@dataclass(frozen=True, eq=False, init=False)
class Tuple:
    """T = (H, z_h, v_b, α) of one leg, where its map lies, and which leg it is.

    Built once, it is handed to the criteria, to foothold selection and to the networks alike.

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
        roll: of the trunk over the whole cycle [rad]. T of the paper has no attitude: its trunk is level.
        pitch: of the trunk over the whole cycle, positive is nose down [rad].
    """

    heights: Array32
    base_twist: tuple[float, ...]
    gait: Gait
    leg: int
    hip_height: float | None
    nominal: tuple[float, float] | None
    roll: float
    pitch: float

    def __init__(
        self,
        heights: ArrayLike,
        *,
        base_twist: Sequence[float] | NDArray[np.floating],
        gait: Gait,
        leg: int,
        hip_height: float | None = None,
        nominal: Sequence[float] | NDArray[np.floating] | None = None,
        roll: float = 0.0,
        pitch: float = 0.0,
        resolution_m: float = RESOLUTION_M,
    ) -> None:
        """Check and keep; ``resolution_m`` is the side of the map's cells: anything but 0.02 m is refused.

        Raises:
            MapError: the map has another size or resolution, or an infinite height.
            StateError: no such leg, or a twist, nominal foothold, hip height or attitude that cannot be.
        """
        keep = object.__setattr__
        keep(self, "heights", _heights(heights, resolution_m))
        keep(self, "base_twist", checked_twist(base_twist))
        keep(self, "gait", gait)
        if leg not in range(4):
            raise StateError(f"leg is {leg!r}, expected 0 to 3 for {', '.join(LEGS)}")
        keep(self, "leg", int(leg))
        if hip_height is not None:
            hip_height = float(hip_height)
            if not math.isfinite(hip_height):
                raise StateError(f"hip height is {hip_height}, expected a finite number of metres")
        keep(self, "hip_height", hip_height)
        place = None if nominal is None else (float(nominal[0]), float(nominal[1]))
        if place is not None and not math.hypot(*place) < _FARTHEST_M:
            raise StateError(f"nominal foothold {place} m from the hip: expected finite, within {_FARTHEST_M:g} m")
        keep(self, "nominal", place)
        roll, pitch = float(roll), float(pitch)
        if not (abs(roll) <= _STEEPEST and abs(pitch) <= _STEEPEST):
            raise StateError(f"roll {roll}, pitch {pitch} of the trunk: expected each within ±{_STEEPEST:g} rad")
        keep(self, "roll", roll)
        keep(self, "pitch", pitch)

    @property
    def hip(self) -> tuple[float, float]:
        """(2,) where the hip is above at touchdown, from the map's centre [m]."""
        return (0.0, 0.0) if self.nominal is None else (-self.nominal[0], -self.nominal[1])

    @property
    def tilted(self) -> bool:
        """Whether the trunk is not level."""
        return self.roll != 0.0 or self.pitch != 0.0

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
    if _any_infinite(h):
        raise MapError("heightmap: a height is infinite; mark unknown cells by NaN")
    return h


@kernel
def _any_infinite(heights: Array32) -> bool:
    for i in range(heights.shape[0]):
        for j in range(heights.shape[1]):
            if np.isinf(heights[i, j]):
                return True
    return False
