"""Terrain around the robot: the elevation grid, which fuses depth images, and the foot costmap derived from it."""

import numpy as np

from legtool_runtime.terrain.costmap import CostmapSettings, FootCostmap, costmap_from_mask, foot_cost, foot_costmap
from legtool_runtime.terrain.elevation import ElevationGrid, ElevationSettings, HeightMap

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


def warm_up() -> None:
    """Compile the kernels of this package or load them from the user's cache. Call it before the robot moves."""
    grid = ElevationGrid(ElevationSettings(size_m=0.4))
    image = np.ones((8, 8), np.float32)
    for _ in range(3):
        grid.update(image, (8.0, 8.0, 3.5, 3.5), transform_camera_to_world=np.eye(4), time_s=0.0)
        foot_costmap(grid.map())
