"""Whether a foot has touched down, and whether it still stands: by its force, and by its height over the map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.errors import TrackingError
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.ground import ground_of, lowest_centre

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TouchdownRules:
    """When a force is a touchdown; forces as shares of the robot's weight.

    A landing foot presses softly: with thresholds of a few per cent the clock stops while the body goes on, and falls.

    Attributes:
        early: force that ends a swing before its time,
        early_phase: from this phase on,
        ticks: at so many measurements in a row.
        due: force that ends a swing that is nearly over,
        due_phase: from this phase on.
        lost_s: a standing foot without ``due`` force for so long does not stand.
        height_m: a touching foot stands only if it is so near to the map's height; a toe on a riser is none.
    """

    early: float = 0.008
    early_phase: float = 0.60
    ticks: int = 2
    due: float = 0.001
    due_phase: float = 0.97
    lost_s: float = 0.04
    height_m: float = 0.03

    def __post_init__(self) -> None:
        shares = (self.early, self.due, self.early_phase, self.due_phase)
        if not all(0.0 < value <= 1.0 for value in shares) or self.ticks < 1 or self.lost_s < 0 or self.height_m <= 0:
            raise TrackingError(
                f"touchdown rules {self}: expected shares of 0 to 1, a tick or more, times and heights above 0"
            )

    @classmethod
    def above_noise(cls, share: float) -> TouchdownRules:
        """Rules for forces that are off by this standard deviation, as a share of the weight; 0: the usual ones.

        Raises:
            TrackingError: a share that is negative, or so large that noise passes for a landing.
        """
        if not 0.0 <= share <= 0.05:
            raise TrackingError(f"touchdown: force noise {share} of the weight, expected 0 to 0.05")
        usual = cls()
        if share == 0.0:
            return usual
        return cls(early=max(usual.early, 4.0 * share), due=max(usual.due, 2.0 * share), ticks=3)


class Touchdowns:
    """Judges the four feet from one measurement to the next."""

    def __init__(self, *, weight: float, radius: float, rules: TouchdownRules | None = None) -> None:
        """Take the robot's weight [N] and its feet's radius [m].

        Raises:
            TrackingError: a weight or radius that is not positive.
        """
        if not (math.isfinite(weight) and weight > 0 and math.isfinite(radius) and radius > 0):
            raise TrackingError(f"touchdown: weight {weight} N, foot radius {radius} m; expected positive numbers")
        self.weight, self.radius = float(weight), float(radius)
        self.rules = TouchdownRules() if rules is None else rules
        self._pressed = np.zeros(4, np.int64)
        self._unloaded_s = np.zeros(4)

    def lifted(self, leg: int) -> None:
        """A leg's swing begins."""
        self._pressed[leg] = 0
        self._unloaded_s[leg] = 0.0

    def lands(
        self, leg: int, *, phase: float, force: float, foot: ArrayLike, elevation: HeightMap | None = None
    ) -> bool:
        """Whether a swinging foot has come to stand.

        Args:
            leg: index.
            phase: of its swing; above 1 when it is late.
            force: along the ground's normal [N]; a value that is not finite counts as none.
            foot: (3,) its centre, world frame [m].
            elevation: the ground; None or unknown there: the force alone tells.
        """
        rules = self.rules
        due = phase >= rules.due_phase
        pressed = force > (rules.due if due else rules.early) * self.weight
        pressed = pressed and phase >= rules.early_phase and self._on_ground(foot, elevation)
        self._pressed[leg] = self._pressed[leg] + 1 if pressed else 0
        landed = self._pressed[leg] >= (1 if due else rules.ticks)
        if landed:
            self._unloaded_s[leg] = 0.0
        return bool(landed)

    def stands(self, leg: int, *, force: float, dt: float) -> bool:
        """Whether a standing foot still carries; once it does not, it has to search for the ground."""
        self._unloaded_s[leg] = 0.0 if force > self.rules.due * self.weight else self._unloaded_s[leg] + dt
        return bool(self._unloaded_s[leg] <= self.rules.lost_s)

    def _on_ground(self, foot: ArrayLike, elevation: HeightMap | None) -> bool:
        if elevation is None:
            return True
        x, y, z = (float(value) for value in np.asarray(foot, dtype=np.float64))
        ground = ground_of(elevation)
        heights = [
            lowest_centre(ground, x + i * ground.cell, y + j * ground.cell, 0.0, False)
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        ]
        known = np.array([h for h in heights if math.isfinite(h)])
        return not len(known) or bool(np.abs(known - (z - self.radius)).min() <= self.rules.height_m)
