"""Terrain around the robot: the elevation grid, which fuses depth images, and the foot costmap derived from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from legtool_runtime.lazy import attributes
from legtool_runtime.terrain.settings import CostmapSettings, ElevationSettings

if TYPE_CHECKING:
    from legtool_runtime.terrain.costmap import FootCostmap, costmap_from_mask, foot_cost, foot_costmap
    from legtool_runtime.terrain.elevation import ElevationGrid, HeightMap

__all__ = [
    "CostmapSettings",
    "ElevationGrid",
    "ElevationSettings",
    "FootCostmap",
    "HeightMap",
    "costmap_from_mask",
    "foot_cost",
    "foot_costmap",
    "warm_up",
]

__getattr__ = attributes(
    __name__,
    {
        "ElevationGrid": "elevation",
        "FootCostmap": "costmap",
        "HeightMap": "elevation",
        "costmap_from_mask": "costmap",
        "foot_cost": "costmap",
        "foot_costmap": "costmap",
    },
)


def warm_up() -> None:
    """Compile the kernels of this package or load them from the user's cache. Call it before the robot moves."""
    import numpy as np

    from legtool_runtime.terrain.conditioning import fill_hidden, without_speckle
    from legtool_runtime.terrain.costmap import foot_costmap
    from legtool_runtime.terrain.elevation import ElevationGrid

    grid = ElevationGrid(ElevationSettings(size_m=0.4))
    image = np.ones((8, 8), np.float32)
    for _ in range(3):
        grid.update(image, (8.0, 8.0, 3.5, 3.5), transform_camera_to_world=np.eye(4), time_s=0.0)
        foot_costmap(grid.map())
    fill_hidden(without_speckle(grid.map()))
