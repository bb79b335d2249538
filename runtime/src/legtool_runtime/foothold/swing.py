"""The path of a swinging foot, and how it bends to a new foothold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.errors import StateError
from legtool_runtime.foothold.criteria.gait_cycle import swing_weights

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Swing:
    """A swing: a cycloid across, cubics up to the apex and down; the path that the criteria judge.

    Attributes:
        lift_off: (3,) the foot's centre when it left the ground [m], any levelled frame.
        foothold: (3,) its centre at touchdown [m].
        height_m: of the apex above the higher of both.
        bends: changes of the foothold on the way: (phase, way) each.
    """

    lift_off: Array
    foothold: Array
    height_m: float
    bends: tuple[tuple[float, Array], ...] = ()

    def position(self, phase: float) -> Array:
        """(3,) the foot's centre at ``phase`` 0 (lift-off) to 1 (touchdown) [m]."""
        w = np.empty(4, np.float32)
        swing_weights(float(phase), w)
        first = self.foothold - sum((way for _, way in self.bends), np.zeros(3))
        apex = max(self.lift_off[2], first[2]) + self.height_m
        out = self.lift_off + (first - self.lift_off) * float(w[0])
        out[2] = w[1] * self.lift_off[2] + w[2] * first[2] + w[3] * apex
        for begin, way in self.bends:
            if phase > begin:
                u = (phase - begin) / (1.0 - begin)
                out = out + way * (u**3 * (10.0 - 15.0 * u + 6.0 * u**2))
        return out

    def adjust(self, foothold: Sequence[float] | Array, *, phase: float) -> Swing:
        """The swing to another foothold from ``phase`` on: position, velocity and acceleration do not jump.

        Args:
            foothold: (3,) the foot's centre at touchdown [m].
            phase: where the swing is now; at 0 the whole path is planned anew.

        Raises:
            StateError: the swing is over.
        """
        new = np.array(foothold, dtype=np.float64)
        if not 0.0 <= phase < 1.0:
            raise StateError(f"swing phase {phase}: expected 0 to below 1; a foot on the ground keeps its foothold")
        if phase == 0.0:
            return replace(self, foothold=new, bends=())
        return replace(self, foothold=new, bends=(*self.bends, (phase, new - self.foothold)))
