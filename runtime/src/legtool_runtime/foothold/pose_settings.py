"""Settings of the body pose optimisation (ViTAL, section IV)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.checks import Bounds, within
from legtool_runtime.errors import StateError

Cost = Literal["sum", "product", "integral", "smoothed", "robust"]
COSTS: tuple[Cost, ...] = ("sum", "product", "integral", "smoothed", "robust")
_BOUNDS = {
    "margin_m": Bounds(0.0, 0.2),
    "horizons": Bounds(1, 4),
    "shift_m": Bounds(0.02, 1.0),
    "smoothness": Bounds(0.0, 1e4),
    "angle": Bounds(0.0, 1.0),
    "height_per_m": Bounds(0.01, 100.0),
    "roll_per_m": Bounds(0.01, 100.0),
    "pitch_per_m": Bounds(0.01, 100.0),
    "stretch": Bounds(0.5, 1.0),
    "ahead_s": Bounds(0.0, 2.0),
}


@dataclass(frozen=True)
class PoseSettings:
    """The pose optimisation.

    Attributes:
        cost: ``sum`` (equation 18), ``product`` (19), ``integral`` (22), ``smoothed`` (34); or ``robust``: the power
            mean of the legs with exponent -2, which the worst leg rules, each by the mean of what it has at the pose
            and of the least within the margin. Sums give up one leg for three; averages see no notch between humps.
        margin_m: m of the integral; the smoothed cost averages five hip heights within it [m].
        horizons: N_h; 1 is the single horizon (section IV-F).
        shift_m: between horizons, in the direction of travel: half the side of a heightmap [m].
        smoothness: weight of the squared change of pose between horizons; the gains are shares of the map, squared.
        angle: largest roll and pitch [rad].
        height_per_m: largest change of height per metre travelled.
        roll_per_m: of roll [rad/m].
        pitch_per_m: of pitch [rad/m].
        stretch: share of the longest span that a standing leg's knee allows; tighter ones lower the trunk onto risers.
        ahead_s: legs that stand keep their bounds until then, carried by the twist [s].
    """

    cost: Cost = "robust"
    margin_m: float = 0.025
    horizons: int = 2
    shift_m: float = 0.33
    smoothness: float = 0.1
    angle: float = 0.35
    height_per_m: float = 1.0
    roll_per_m: float = 1.5
    pitch_per_m: float = 2.0
    stretch: float = 1.0
    ahead_s: float = 0.3

    def __post_init__(self) -> None:
        if self.cost not in COSTS:
            raise StateError(f"pose settings: cost is {self.cost!r}, expected one of {', '.join(COSTS)}")
        within("pose settings", self, _BOUNDS, StateError)

    @property
    def per_m(self) -> NDArray[np.float64]:
        """(3,) most change of height [1], roll and pitch [rad/m] per metre travelled."""
        return np.array([self.height_per_m, self.roll_per_m, self.pitch_per_m])

    def limited(self, wanted: ArrayLike, *, before: ArrayLike | None, travelled_m: float) -> NDArray[np.float64]:
        """The pose (3,) nearest to a wanted one that may be taken ``travelled_m`` after another; None: after none."""
        pose = np.array(wanted, dtype=np.float64)
        pose[1:] = np.clip(pose[1:], -self.angle, self.angle)
        if before is None:
            return pose
        last, reach = np.asarray(before, dtype=np.float64), self.per_m * travelled_m
        return np.clip(pose, last - reach, last + reach)

    @property
    def offsets(self) -> list[float]:
        """Hip heights beside a pose's own over which its cost averages the safe footholds (equations 22, 34) [m]."""
        m = self.margin_m
        if self.cost == "integral":
            return [-m, m]
        if self.cost == "smoothed":
            return [-m, -0.5 * m, 0.0, 0.5 * m, m]
        return [0.0]
