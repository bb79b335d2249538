"""Regions in the closed loop: perception of the walk's own images, or the true ones."""

from dataclasses import replace

import numpy as np

from legtool.configs.camera import DepthCamera, DepthNoise
from legtool.sim.sensors.depth_camera import side_cameras
from legtool.sim.walks.region_finder import RegionFinder
from legtool.sim.walks.simulated import Eyes
from legtool_runtime.perception import NON_PASSABLE, STEPPABLE
from legtool_runtime.perception.chain import PerceptionSettings
from legtool_runtime.perception.egocan import EgocanSettings
from legtool_runtime.perception.regions import Regions

CAMERA = DepthCamera(width=160, height=120, pitch=0.5, noise=DepthNoise(steps=()))
SETTINGS = PerceptionSettings(egocan=EgocanSettings(lift=0.3))


def covered(regions: Regions, x: float, y: float) -> bool:
    for k in range(len(regions)):
        corners = regions.corners_world(k)[:, :2]
        edges = np.roll(corners, -1, axis=0) - corners
        away = np.array([x, y]) - corners
        if (edges[:, 0] * away[:, 1] - edges[:, 1] * away[:, 0] >= 0).all():
            return True
    return False


def test_true_regions_are_those_around_the_robot(make, world) -> None:
    environment = make(eyes=Eyes(CAMERA, regions_m=1.6))
    observation = environment.observe()
    found = RegionFinder(environment.simulation.robot.geometry, SETTINGS).see(observation)
    assert found is observation.regions and len(found)
    assert np.hypot(*found.poses[:, :2, 3].T).max() <= 1.6
    # The course's gap, from x = 1.2 to 1.3 m, has none.
    for x in (1.05, 1.15):
        assert covered(found, x, 0.03) and world.on_ground([[x, 0.03, 0.0]])[0]
    assert not any(covered(found, x, y) for x in (1.22, 1.28) for y in (-0.3, 0.0, 0.3))
    assert observation.image is not None  # a map may still be made of images


def test_perception_finds_the_regions_that_its_camera_sees(make) -> None:
    environment = make(eyes=Eyes(CAMERA, labelled_m=0.1))
    observation = environment.observe()
    finder = RegionFinder(environment.simulation.robot.geometry, SETTINGS)
    found = finder.see(observation)
    assert found is not None and len(finder.times_s) == 1
    assert covered(found, 0.9, 0.02) and not covered(found, 1.25, 0.02)
    assert finder.see(environment.observe()) is None or environment.simulation.tick == 0
    heights = found.poses[~found.assumed, 2, 3]
    np.testing.assert_allclose(heights, 0.0, atol=0.01)


def test_where_the_camera_sees_nothing_the_regions_are_those_of_before(make) -> None:
    """At the end of the world every ray leads into the air: no error, and the plan goes on by what was seen."""
    environment = make(eyes=Eyes(CAMERA, labelled_m=0.1))
    observation = environment.observe()
    blank = replace(observation, image=replace(observation.image, depth=np.full_like(observation.image.depth, np.nan)))
    finder = RegionFinder(environment.simulation.robot.geometry, SETTINGS)
    assert finder.see(blank) is None
    found = finder.see(observation)
    assert found is not None and finder.see(blank) is found


def test_without_labels_nothing_that_was_seen_is_stepped_on(make) -> None:
    observation = make(eyes=Eyes(CAMERA)).observe()
    robot = make().simulation.robot.geometry
    blank = RegionFinder(robot, SETTINGS).see(observation)
    assert blank is not None and not covered(blank, 0.9, 0.02)

    def segment(depth):
        return np.where(np.isnan(depth), NON_PASSABLE, STEPPABLE).astype(np.uint8)

    found = RegionFinder(robot, SETTINGS, segment).see(observation)
    assert found is not None and covered(found, 0.9, 0.02)


def test_side_cameras_show_the_ground_beside_the_robot(make) -> None:
    eyes = Eyes(CAMERA, labelled_m=0.1, beside=side_cameras(CAMERA))
    observation = make(eyes=eyes).observe()
    assert len(observation.beside) == 2
    robot = make().simulation.robot.geometry
    both = RegionFinder(robot, SETTINGS).see(observation)
    ahead = RegionFinder(robot, SETTINGS).see(make(eyes=Eyes(CAMERA, labelled_m=0.1)).observe())
    assert both is not None and ahead is not None
    for y in (0.85, -0.85):
        assert covered(both, 0.0, y) and not covered(ahead, 0.0, y)
    # What looks to the left looks to the left.
    for image, side in zip(observation.beside, (1.0, -1.0), strict=True):
        axis = image.transform_camera_to_base[:3, 2]
        assert side * axis[1] > 0.8 and abs(axis[0]) < 1e-9 and axis[2] < -0.4
        assert side * image.transform_camera_to_base[1, 3] == 0.2
