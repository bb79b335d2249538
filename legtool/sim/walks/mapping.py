"""The robot's own map: depth images fused at the pose that it believes, or the true heights as they are given."""

from __future__ import annotations

import numpy as np

from legtool.sim.walks.environment import Observation
from legtool_runtime.robot import Robot
from legtool_runtime.rotations import rotation_of
from legtool_runtime.terrain.conditioning import fill_hidden, without_speckle
from legtool_runtime.terrain.elevation import ElevationGrid, HeightMap
from legtool_runtime.terrain.settings import ElevationSettings

#: The ground around a standing robot is taken to be flat within this: its camera does not see its own feet [m].
_ASSUMED_FLAT_M = 0.9


class Mapper:
    """Makes a map from what a robot observes."""

    def __init__(self, robot: Robot, settings: ElevationSettings, *, for_feet: bool = False) -> None:
        """Begin a walk.

        Args:
            robot: whose camera it is.
            settings: of the map.
            for_feet: whether maps of images are made fit for footholds (:mod:`legtool_runtime.terrain.conditioning`).
        """
        self._robot, self._grid, self._for_feet = robot, ElevationGrid(settings), for_feet
        self._begun = False

    def see(self, observation: Observation) -> HeightMap | None:
        """A new map where there is something new to see; else None."""
        if observation.terrain is not None or observation.image is None:
            return observation.terrain
        state, image, grid = observation.state, observation.image, self._grid
        here = state.position_world
        grid.move_to(here[:2])
        if not self._begun:
            ground = here[2] - self._robot.standing_height
            grid.assume_flat(here[:2], radius_m=_ASSUMED_FLAT_M, height_m=ground)
            self._begun = True
        base = np.eye(4)
        base[:3, :3], base[:3, 3] = rotation_of(state.orientation), here
        for one in (*observation.beside, image):
            camera = one.camera
            intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
            pose = base @ one.transform_camera_to_base
            grid.update(one.depth, intrinsics, transform_camera_to_world=pose, time_s=observation.time_s)
        seen = grid.map()
        return fill_hidden(without_speckle(seen)) if self._for_feet else seen
