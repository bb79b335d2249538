"""A simulated robot sees by its own camera: range, rate and errors are those of its YAML."""

import numpy as np

from legtool.configs.camera import DepthCamera, DepthNoise
from legtool.sim.walks.environment import VelocityCommand
from legtool.sim.walks.simulated import Eyes
from legtool_runtime.terrain.settings import ElevationSettings

CAMERA = DepthCamera(width=80, height=60, pitch=0.4, range_m=(0.3, 1.2), noise=DepthNoise(steps=()))


def test_the_range_of_the_camera_holds_in_the_closed_loop(make) -> None:
    depth = make(eyes=Eyes(CAMERA)).observe().image.depth
    assert np.nanmin(depth) >= 0.3 and np.nanmax(depth) <= 1.2
    assert np.isnan(depth).any() and np.isfinite(depth).any()
    far = make(eyes=Eyes(CAMERA.replace(range_m=(0.3, 6.0)))).observe().image.depth
    assert np.nanmax(far) > 1.5


def test_images_come_at_the_rate_of_the_camera(make) -> None:
    environment = make(eyes=Eyes(CAMERA.replace(rate_hz=20.0)))
    environment.begin()
    stamps = []
    for _ in range(400):
        observation = environment.observe()
        if observation.image is not None:
            stamps.append(observation.time_s)
        environment.apply(VelocityCommand(np.zeros(3)))
    np.testing.assert_allclose(np.diff(stamps), 0.05, atol=1e-9)


def test_noise_is_that_of_the_camera_and_drawn_from_the_trial(make) -> None:
    noisy = Eyes(CAMERA.replace(noise=DepthNoise(steps=("gaussian_noise",), surface_sigma=0.01)))
    exact = make(eyes=Eyes(CAMERA)).observe().image.depth
    one, same, other = (make(eyes=noisy, rng=np.random.default_rng(seed)).observe().image.depth for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other, equal_nan=True)
    assert 0.001 < np.nanstd(one - exact) < 0.05


def test_true_heights_stand_in_for_images(make, world) -> None:
    observation = make(eyes=Eyes(CAMERA, ElevationSettings(size_m=3.0))).observe()
    assert observation.image is None
    terrain = observation.terrain
    i = int((1.25 - terrain.lower_corner[0]) / terrain.resolution_m)
    assert terrain.heights[i, terrain.heights.shape[1] // 2] == np.float32(world.height(1.25, 0.0))


def test_a_robot_starts_where_the_world_says(make, world) -> None:
    environment = make(start=(0.2, -0.1, 0.05))
    np.testing.assert_allclose(environment.simulation.state.position_world[:2], [0.2, -0.1])
