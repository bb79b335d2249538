"""Settings of the terrain around the robot; they are read without numba."""

from __future__ import annotations

from dataclasses import dataclass, fields

from legtool_runtime.checks import Bounds, within
from legtool_runtime.errors import MapError

_BOUNDS = {
    "size_m": Bounds(0.1, 50.0),
    "resolution_m": Bounds(0.002, 0.5),
    "min_range_m": Bounds(0.0, 10.0),
    "max_range_m": Bounds(0.1, 50.0),
    "range_noise": Bounds(0.0, 0.1),
    "base_noise_m": Bounds(1e-4, 0.1),
    "gate": Bounds(1.0, 10.0),
    "drift_m_per_sqrt_s": Bounds(0.0, 0.1),
    "replace_after_s": Bounds(0.0, 60.0),
    "ceiling_m": Bounds(-5.0, 50.0),
    "jump": Bounds(0.005, 10.0),
    "bridge_m": Bounds(0.0, 0.5),
    "support": Bounds(0.0, 1.0),
}


@dataclass(frozen=True)
class ElevationSettings:
    """How depth images are turned into heights.

    Attributes:
        size_m: side of the square map.
        resolution_m: side of a cell.
        min_range_m: nearer points are ignored (distance along the optical axis).
        max_range_m: farther points are ignored.
        range_noise: standard deviation of a depth reading, divided by its square [1/m]; stereo noise grows with range².
        base_noise_m: standard deviation of a height at zero range.
        gate: number of standard deviations by which two heights may differ and still count as one surface.
        drift_m_per_sqrt_s: how fast an old height becomes uncertain because of the drift of the pose.
        replace_after_s: a lower surface seen for this long replaces a higher one that is no longer seen.
        ceiling_m: points higher than this above the camera are ignored, so that the robot can walk beneath them.
        jump: a pixel that differs from both its neighbours by this share of its depth is a mixed reading at an edge.
        bridge_m: at grazing angles, rows of pixels that hit one surface no farther apart than this are joined.
        support: a cell is known only if this share of the pixels expected there hit it: range noise throws points over
            edges, and later images need not contradict them.
    """

    size_m: float = 4.0
    resolution_m: float = 0.02
    min_range_m: float = 0.15
    max_range_m: float = 3.5
    range_noise: float = 0.004
    base_noise_m: float = 0.002
    gate: float = 3.0
    drift_m_per_sqrt_s: float = 0.003
    replace_after_s: float = 1.0
    ceiling_m: float = 0.2
    jump: float = 0.05
    bridge_m: float = 0.05
    support: float = 0.4

    def __post_init__(self) -> None:
        within("elevation settings", self, _BOUNDS, MapError)
        if self.min_range_m >= self.max_range_m:
            raise MapError(f"elevation settings: min_range_m {self.min_range_m} is not below {self.max_range_m}")
        if not 3 <= round(self.size_m / self.resolution_m) <= 4000:
            raise MapError(
                f"elevation settings: {self.size_m} m at {self.resolution_m} m a cell; expected 3 to 4000 cells a side"
            )


@dataclass(frozen=True)
class CostmapSettings:
    """Which cells are unsafe.

    Attributes:
        height_threshold_m: greatest height difference within the neighbourhood of a safe cell.
        window_m: width of that neighbourhood, a square around the cell.
        step_window_m: width of the square in which ground that lies lower by a step (by more than
            ``height_threshold_m`` and less than ``drop_threshold_m``) makes a cell unsafe: a foot that swings up a
            step is stopped by it before it reaches its landing point, and one that stands above an edge rolls over it.
        drop_threshold_m: a cell this far below the highest cell nearby is unsafe, which includes the floor of a gap.
        drop_window_m: width of the square that counts as nearby; at least twice the widest gap to be recognised.
        unknown_unsafe: whether unseen cells, and everything beyond the map, count as unsafe. Several unseen cells side
            by side may hide an edge, so that cells near them are as unsafe as cells near a visible edge.
    """

    height_threshold_m: float = 0.03
    window_m: float = 0.04
    step_window_m: float = 0.08
    drop_threshold_m: float = 0.12
    drop_window_m: float = 0.4
    unknown_unsafe: bool = True

    def __post_init__(self) -> None:
        within("costmap settings", self, {item.name: Bounds(0.001, 2.0, "m") for item in fields(self)[:5]}, MapError)
        if not isinstance(self.unknown_unsafe, bool):
            raise MapError(f"costmap settings: unknown_unsafe is {self.unknown_unsafe!r}, expected true or false")
