"""The map around a walking robot: from its own depth camera, or the truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool.configs.robots import DepthCamera
from legtool.sim.walks.simulation import Simulation
from legtool.sim.worlds.course import Course
from legtool.sim.worlds.raycast import Scene, box, camera_pose, cast, plane
from legtool_runtime.rotations import rotation_of
from legtool_runtime.terrain.elevation import ElevationGrid, ElevationSettings, HeightMap

Array = NDArray[np.float64]

#: The simulated depth camera: rate [Hz], and standard deviation of its readings over their square [1/m].
CAMERA_RATE_HZ = 15
DEPTH_NOISE = 0.003
DEPTH_FAR_M = 4.0


class CameraMap:
    """The elevation map that the robot's own depth camera builds."""

    def __init__(
        self, course: Course, camera: DepthCamera, rng: np.random.Generator, settings: ElevationSettings
    ) -> None:
        self._scene = course_scene(course)
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

    def __init__(self, course: Course, settings: ElevationSettings) -> None:
        self._course = course
        self._settings = settings

    def look(self, simulation: Simulation) -> HeightMap:
        """The true heights, on a grid aligned with the world."""
        r = self._settings.resolution_m
        n = round(self._settings.size_m / r)
        first = np.round(simulation.state.position_world[:2] / r - 0.5 * n)
        x = (first[0] + np.arange(n) + 0.5) * r
        y = (first[1] + np.arange(n) + 0.5) * r
        return HeightMap(self._course.height(x[:, None], y[None, :]).astype(np.float32), r, (first + 0.5 * n) * r)


def course_scene(course: Course) -> Scene:
    """The course for the ray caster: its boxes over the pit's floor."""
    upright = np.eye(3)
    boxes = [
        box((high + low) / 2, upright, ((high - low) / 2).tolist())
        for low, high in zip(course.lower, course.upper, strict=True)
    ]
    return Scene.of([*boxes, plane((0.0, 0.0, -course.settings.pit_depth), upright)])
