"""The one depth camera: its range and errors are those of its settings, and the exact image stays exact."""

import numpy as np
import pytest

from legtool.configs.camera import DepthCamera, DepthNoise
from legtool.errors import SettingsError
from legtool.sim.sensors import depth_camera
from legtool.sim.sensors.depth_camera import look
from legtool.sim.worlds.builder import Builder
from legtool.sim.worlds.raycast import Scene, box, camera_pose, cast
from legtool.sim.worlds.world import CUBOID

CAMERA = DepthCamera(width=64, height=48, range_m=(0.3, 5.0))
POSE = camera_pose([0, 0, 0.5], pitch=0.3)


@pytest.fixture
def scene() -> Scene:
    builder = Builder()
    builder.add(CUBOID, box([0.3, 0, 0.4], np.eye(3), [0.1, 0.1, 0.4]), 0.8)
    return builder.world.scene


def test_a_look_leaves_the_image_of_the_caster_as_it_is(scene, monkeypatch):
    kept = []
    monkeypatch.setattr(depth_camera, "cast", lambda *a, **k: kept.append(cast(*a, **k)) or kept[-1])
    seen = look(scene, CAMERA, POSE, np.random.default_rng(0)).seen
    exact = kept[0].depth
    near = exact < 0.3
    assert near.any() and np.isnan(seen.depth[near]).all()
    np.testing.assert_array_equal(seen.depth[~near], exact[~near])


def test_without_errors_depth_is_exact_within_the_range(scene):
    image = look(scene, CAMERA, POSE, np.random.default_rng(0), noise=DepthNoise(steps=()))
    np.testing.assert_array_equal(image.depth, image.seen.depth)
    assert np.nanmin(image.depth) >= 0.3 and np.nanmax(image.depth) <= 5.0


def test_the_same_generator_gives_the_same_errors(scene):
    one, same, other = (look(scene, CAMERA, POSE, np.random.default_rng(seed)).depth for seed in (0, 0, 1))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other, equal_nan=True)


def test_a_range_that_ends_before_it_begins_is_refused():
    with pytest.raises(SettingsError, match="expected the smallest depth, then the largest"):
        CAMERA.replace(range_m=(2.0, 1.0))
