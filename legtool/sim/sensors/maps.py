"""The map around a walking robot: from its own depth camera, or the truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool.configs.robots import DepthCamera
from legtool.sim.walks.simulation import Simulation, rotation_of
from legtool.sim.worlds.heights import elevation_map
from legtool.sim.worlds.raycast import camera_pose, cast
from legtool.sim.worlds.world import World
from legtool_runtime.terrain.elevation import ElevationGrid, ElevationSettings, HeightMap

Array = NDArray[np.float64]

#: The simulated depth camera: rate [Hz], and standard deviation of its readings over their square [1/m].
CAMERA_RATE_HZ = 15
DEPTH_NOISE = 0.003
DEPTH_FAR_M = 4.0


class CameraMap:
    """The elevation map that the robot's own depth camera builds."""

    def __init__(
        self, course: World, camera: DepthCamera, rng: np.random.Generator, settings: ElevationSettings
    ) -> None:
        self._scene = course.scene
        self._mount = camera
        self._camera = camera.camera()
        self._intrinsics = np.array([self._camera.fx, self._camera.fy, self._camera.cx, self._camera.cy])
        self._rng = rng
        self.grid = ElevationGrid(settings)
        self._begun = False

    def look(self, simulation: Simulation) -> HeightMap:
        """Take an image from where the camera truly is, and fuse it at where the robot believes it is."""
        robot, data, state = simulation.robot, simulation.data, simulation.state
        base = data.qpos[robot.base_qpos : robot.base_qpos + 7]
        seen = cast(self._scene, self._camera, self._pose(base[:3], base[3:]), far=DEPTH_FAR_M, normals=False)
        depth = seen.depth + self._rng.standard_normal(seen.depth.shape, np.float32) * (DEPTH_NOISE * seen.depth**2)
        here = state.position_world
        self.grid.move_to(here[:2])
        if not self._begun:
            ground = here[2] - robot.geometry.standing_height
            self.grid.assume_flat(here[:2], radius_m=0.9, height_m=ground)
            self._begun = True
        pose = self._pose(here, state.orientation)
        self.grid.update(depth, self._intrinsics, transform_camera_to_world=pose, time_s=simulation.time_s)
        return self.grid.map()

    def _pose(self, position: Array, orientation: Array) -> Array:
        base = np.eye(4)
        base[:3, :3] = rotation_of(orientation)
        base[:3, 3] = position
        pose: Array = base @ camera_pose(self._mount.position, pitch=self._mount.pitch)
        return pose


class TrueMap:
    """The course itself as a map around the robot."""

    def __init__(self, course: World, settings: ElevationSettings) -> None:
        self._course = course
        self._settings = settings

    def look(self, simulation: Simulation) -> HeightMap:
        """The true heights, on a grid aligned with the world."""
        here = simulation.state.position_world[:2]
        return elevation_map(self._course, here, self._settings.size_m, self._settings.resolution_m)
