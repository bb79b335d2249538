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
        due_phase: from this phase on,
        evidence: once the forces of its ticks exceed ``due`` by so much in all (Page's cumulative sum).
        borne: force that a standing foot bears in the mean;
        lost_s: one without any for so long does not stand.
        height_m: a touching foot stands only if it is so near to the map's height, or to its foothold: a toe on a
            riser stands on neither.
    """

    early: float = 0.008
    early_phase: float = 0.60
    ticks: int = 2
    due: float = 0.001
    due_phase: float = 0.97
    evidence: float = 0.0
    borne: float = 0.001
    lost_s: float = 0.04
    height_m: float = 0.03

    def __post_init__(self) -> None:
        shares = (self.early, self.due, self.borne, self.early_phase, self.due_phase)
        sound = all(0.0 < value <= 1.0 for value in shares) and 0.0 <= self.evidence <= 1.0
        if not sound or self.ticks < 1 or not self.lost_s > 0 or not self.height_m > 0:
            raise TrackingError(
                f"touchdown rules {self}: expected shares of 0 to 1, a tick or more, times and heights above 0"
            )

    @classmethod
    def above_noise(cls, share: float) -> TouchdownRules:
        """Rules for forces that are off by this standard deviation, as a share of the weight; 0: the usual ones.

        A foot that is taken to stand and does not is pushed by its leg beside its foothold within 20 ms; one that
        stands and is waited for bears a deviation or two while the body tips. By these rules noise alone is a touchdown
        once in some 80,000 ticks, a force of nine deviations is one at its first tick, one of 1.2 within some 14.

        Raises:
            TrackingError: a share that is negative, or so large that noise passes for a landing.
        """
        if not 0.0 <= share <= 0.05:
            raise TrackingError(f"touchdown: force noise {share} of the weight, expected 0 to 0.05")
        usual = cls()
        if share == 0.0:
            return usual
        return cls(
            early=max(usual.early, 4.0 * share), ticks=3,
            due=max(usual.due, 0.6 * share), evidence=8.0 * share, borne=max(usual.borne, share),
        )  # fmt: skip


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
        self._evidence = np.zeros(4)
        self._borne = np.full(4, self._most_borne)

    @property
    def _most_borne(self) -> float:
        """What is remembered of the force that a foot bears, at most [N]: it is forgotten within ``lost_s``."""
        return math.e * self.rules.borne * self.weight

    def lifted(self, leg: int) -> None:
        """A leg's swing begins."""
        self._pressed[leg] = 0
        self._evidence[leg] = 0.0

    def lands(
        self, leg: int, *, phase: float, force: float, foot: ArrayLike, elevation: HeightMap | None = None,
        foothold: ArrayLike | None = None,
    ) -> bool:  # fmt: skip
        """Whether a swinging foot has come to stand.

        Args:
            leg: index.
            phase: of its swing; above 1 when it is late.
            force: along the ground's normal [N]; a value that is not finite counts as none.
            foot: (3,) its centre, world frame [m].
            elevation: the ground; None or unknown there: the force alone tells.
            foothold: (3,) where its centre is to stand, world frame [m]: there is ground whatever the map says.
        """
        rules, force = self.rules, force if math.isfinite(force) else 0.0
        touches = phase >= rules.early_phase and (self._is_at(foot, foothold) or self._on_ground(foot, elevation))
        if not touches:
            self._pressed[leg], self._evidence[leg] = 0, 0.0
            return False
        self._pressed[leg] = self._pressed[leg] + 1 if force > rules.early * self.weight else 0
        landed = self._pressed[leg] >= rules.ticks
        if phase >= rules.due_phase:
            self._evidence[leg] = max(self._evidence[leg] + force - rules.due * self.weight, 0.0)
            landed |= self._evidence[leg] > rules.evidence * self.weight
        if landed:
            self._borne[leg] = self._most_borne
        return bool(landed)

    def stands(self, leg: int, *, force: float, dt: float) -> bool:
        """Whether a standing foot still carries; once it does not, it has to search for the ground."""
        share = 1.0 - math.exp(-dt / self.rules.lost_s)
        self._borne[leg] = min(self._borne[leg] + share * (force - self._borne[leg]), self._most_borne)
        return bool(self._borne[leg] >= (1.0 - 1e-9) * self.rules.borne * self.weight)

    def _is_at(self, foot: ArrayLike, foothold: ArrayLike | None) -> bool:
        return foothold is not None and bool(np.linalg.norm(np.subtract(foot, foothold)) <= self.rules.height_m)

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
