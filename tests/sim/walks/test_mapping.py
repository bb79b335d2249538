"""The robot's own map in the closed loop."""

from dataclasses import replace

import numpy as np

from legtool.configs.camera import DepthCamera, DepthNoise
from legtool.sim.sensors.depth_camera import side_cameras
from legtool.sim.walks.mapping import Mapper
from legtool.sim.walks.simulated import Eyes
from legtool_runtime.terrain.settings import ElevationSettings

CAMERA = DepthCamera(width=160, height=120, pitch=0.5, noise=DepthNoise(steps=()))


def test_side_cameras_are_fused_into_the_map_too(make) -> None:
    """A robot that walks sideways would else find its way filled with the ground that it saw last."""
    environment = make(eyes=Eyes(CAMERA, beside=side_cameras(CAMERA)))
    observation = environment.observe()
    robot, settings = environment.simulation.robot.geometry, ElevationSettings(resolution_m=0.04)
    ahead = Mapper(robot, settings).see(replace(observation, beside=()))
    around = Mapper(robot, settings).see(observation)
    assert ahead is not None and around is not None
    new = np.isfinite(around.heights) & ~np.isfinite(ahead.heights)
    left, right = np.split(new, 2, axis=1)
    assert left.sum() > 50 and right.sum() > 50
    i, j = np.nonzero(new)
    x, y = (around.lower_corner + (np.stack([i, j], axis=-1) + 0.5) * around.resolution_m).T
    off = around.heights[new] - environment.world.height(x, y)
    assert np.median(np.abs(off)) < 0.005 and np.mean(np.abs(off) < 0.02) > 0.95  # but for cells at edges
