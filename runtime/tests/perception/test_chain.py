import itertools
import threading
import time

import numpy as np
import pytest

from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception import STEPPABLE, UNKNOWN
from legtool_runtime.perception.camera import Camera
from legtool_runtime.perception.chain import Perception, PerceptionSettings, warm_up
from legtool_runtime.perception.egocan import EgocanSettings
from legtool_runtime.perception.steppability import Segmenter, Sensor
from legtool_runtime.perception.superpixels import SuperpixelSettings

CAMERA = Camera.from_field_of_view(320, 240, np.deg2rad(80))
SETTINGS = PerceptionSettings(
    egocan=EgocanSettings(side=128, lift=0.3), superpixels=SuperpixelSettings(number=80, least=12)
)
BOX = ((0.9, 0.0, 0.06), (0.2, 0.2, 0.06), 0.0)


def base_pose(x=0.0):
    pose = np.eye(4)
    pose[:3, 3] = x, 0.0, 0.4
    return pose


class Robot:
    """A robot that walks ahead past a box, and sees it."""

    def __init__(self, world, **kwargs):
        self.world = world
        self.mount = world.camera_pose([0.3, 0.0, 0.1], 0.8)
        self.chain = Perception(CAMERA, self.mount, standing_height=0.4, settings=SETTINGS, **kwargs)

    def see(self, x):
        depth, _, face = self.world.render(CAMERA, base_pose(x) @ self.mount, boxes=[BOX])
        steppable = (face == 0) | (face == 12)
        return depth, np.where(steppable, STEPPABLE, np.where(face < 0, UNKNOWN, 3)).astype(np.uint8)

    def step(self, x):
        return self.chain.update(self.see(x)[0], base_pose(x))


@pytest.fixture
def robot(world):
    made = []

    def make(**kwargs):
        made.append(Robot(world, **kwargs))
        return made[-1]

    yield make
    for one in made:
        one.chain.close()


def test_given_labels_the_box_and_the_floor_become_regions_in_the_world(robot):
    one = robot()
    for k in range(8):
        depth, labels = one.see(0.04 * k)
        terrain = one.chain.update(depth, base_pose(0.04 * k), labels=labels)
    regions = terrain.regions
    seen = ~regions.assumed
    height = regions.poses[seen, 2, 3]
    assert np.abs(height[:, None] - [0.0, 0.12]).min(axis=1).max() < 1e-3
    tops = np.flatnonzero(seen)[height > 0.1]
    assert regions.areas[tops].sum() > 0.6 * 0.4**2
    for k in tops:
        assert (np.abs(regions.corners_world(k)[:, :2] - BOX[0][:2]) < 0.2 + 1e-3).all()
    assert terrain.label_age == 0


def test_only_assumed_ground_is_steppable_until_labels_come(robot):
    go = threading.Event()
    one = robot(segment=lambda depth: np.full(depth.shape, STEPPABLE, np.uint8) if go.wait(20) else None)
    start = time.perf_counter()
    for k in range(4):
        terrain = one.step(0.02 * k)
        assert len(terrain.regions) > 0
        assert terrain.regions.assumed.all()
        assert terrain.label_age == np.inf
    assert time.perf_counter() - start < 10  # it never waited
    go.set()
    end = time.monotonic() + 10
    k = 4
    while terrain.label_age == np.inf:
        assert time.monotonic() < end
        time.sleep(0.01)
        terrain = one.step(0.02 * k)
        k += k < 20
    assert (~terrain.regions.assumed).sum() > 5
    assert 0 <= terrain.label_age < 15


def test_regions_keep_their_identity_from_frame_to_frame(robot):
    one = robot()
    ids = []
    for k in range(6):
        depth, labels = one.see(0.01 * k)
        ids.append(set(one.chain.update(depth, base_pose(0.01 * k), labels=labels).regions.ids))
    for before, after in itertools.pairwise(ids[2:]):
        assert len(before & after) > 0.85 * len(before)


def test_a_refused_image_changes_nothing_and_the_next_carries_on(robot):
    one, twin = robot(), robot()
    depth, labels = one.see(0.0)
    one.chain.update(depth, base_pose(), labels=labels)
    twin.chain.update(depth, base_pose(), labels=labels)
    with pytest.raises(PerceptionError, match="none of its"):
        one.chain.update(np.zeros_like(depth), base_pose(0.01))
    with pytest.raises(PerceptionError, match="millimetres"):
        one.chain.update(depth * 1000, base_pose(0.01))
    with pytest.raises(PerceptionError, match="shape"):
        one.chain.update(depth[::2, ::2], base_pose(0.01))
    with pytest.raises(PerceptionError, match="jumped by"):
        one.chain.update(depth, base_pose(5.0))
    with pytest.raises(PerceptionError, match="label image"):
        one.chain.update(depth, base_pose(0.01), labels=labels[::2])
    depth, labels = one.see(0.02)
    a = one.chain.update(depth, base_pose(0.02), labels=labels)
    b = twin.chain.update(depth, base_pose(0.02), labels=labels)
    np.testing.assert_allclose(a.regions.areas, b.regions.areas, rtol=0.2)
    assert list(a.regions.ids) == list(b.regions.ids)


def test_another_camera_adds_what_it_sees(robot, world):
    one, alone = robot(), robot()
    side = world.camera_pose([0.0, 0.2, 0.1], 0.8)
    turned = np.eye(4)
    turned[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    side[:3, :3] = turned[:3, :3] @ side[:3, :3]
    camera = Camera.from_field_of_view(160, 120, np.deg2rad(70))
    depth, _, face = world.render(camera, base_pose() @ side, boxes=[BOX])
    labels = np.where(face == 0, STEPPABLE, UNKNOWN).astype(np.uint8)
    one.chain.look(depth, base_pose(), camera=camera, transform_camera_to_base=side, labels=labels)
    ahead, ahead_labels = one.see(0.0)
    both = one.chain.update(ahead, base_pose(), labels=ahead_labels).regions
    less = alone.chain.update(ahead, base_pose(), labels=ahead_labels).regions

    def left(regions):
        return regions.areas[~regions.assumed & (regions.poses[:, 1, 3] > 0.6) & (regions.poses[:, 0, 3] < 0.2)].sum()

    assert left(both) > 0.2 and left(less) < 0.05
    with pytest.raises(PerceptionError, match="shape"):
        one.chain.look(depth[::2], base_pose(), camera=camera, transform_camera_to_base=side)


def test_a_label_image_without_its_depth_is_refused(robot):
    one = robot()
    with pytest.raises(PerceptionError, match="a label image came without its depth image"):
        one.chain.update(None, base_pose(), labels=np.ones((240, 320), np.uint8))
    with pytest.raises(PerceptionError, match=r"no depth image; .* call move\(pose\)"):
        one.chain.update(None, base_pose())


def test_a_segmenter_of_another_camera_is_refused():
    class Known(Segmenter):
        def __init__(self, camera):
            self.sensor = Sensor(camera, np.eye(4), 0.4)

    Perception(CAMERA, np.eye(4), standing_height=0.4, segment=Known(CAMERA)).close()
    for other in (
        Camera.from_field_of_view(320, 240, np.deg2rad(70)),
        Camera(320, 240, CAMERA.fx, CAMERA.fy, 120, 120),
    ):
        with pytest.raises(PerceptionError, match="trained for a camera"):
            Perception(CAMERA, np.eye(4), standing_height=0.4, segment=Known(other))


def test_after_a_reset_the_robot_may_stand_anywhere(robot):
    one = robot()
    one.step(0.0)
    one.chain.reset()
    terrain = one.step(10.0)
    assert terrain.regions.assumed.all()
    assert np.abs(terrain.regions.poses[:, 0, 3] - 10).max() < 0.5


def test_between_images_the_chain_follows_the_robot(robot):
    one = robot()
    depth, labels = one.see(0.0)
    one.chain.update(depth, base_pose(0.0), labels=labels)
    for k in range(1, 51):
        one.chain.move(base_pose(0.002 * k))
    points = one.chain.egocan.floor().points
    top = points[np.abs(points[..., 2] - (0.12 - 0.7)) < 1e-3]
    assert top[:, 0].min() == pytest.approx(0.9 - 0.2 - 0.1, abs=0.02)


def test_warm_up_leaves_no_kernel_to_compile():
    warm_up()
    start = time.perf_counter()
    warm_up()
    assert time.perf_counter() - start < 1.0


def test_settings_out_of_range_are_refused():
    with pytest.raises(PerceptionError, match="assumed_radius"):
        PerceptionSettings(assumed_radius=-1)
    with pytest.raises(PerceptionError, match="normal_reach"):
        PerceptionSettings(normal_reach=-1)
