import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.configs.scenes import SceneSettings
from legtool.configs.world_parts import SHAPES
from legtool.sim.sensors.camera_motion import camera_poses
from legtool.sim.worlds.placement import draw_scene
from legtool.sim.worlds.world import POLE, WALL

ROBOT = load_robot("go2")


def draw(seed, **settings):
    return draw_scene(SceneSettings(**settings), ROBOT, np.random.default_rng(seed))


def test_a_scene_is_the_same_bits_for_the_same_seed_and_another_for_another():
    one, two, other = draw(1), draw(1), draw(2)
    for name in ("kinds", "sizes", "positions", "rotations"):
        np.testing.assert_array_equal(getattr(one.world.scene, name), getattr(two.world.scene, name))
    assert one.heading != other.heading


def test_every_class_and_placement_comes_up():
    scenes = [draw(seed) for seed in range(40)]
    classes = set(np.concatenate([scene.world.classes for scene in scenes]))
    assert classes == set(range(len(SHAPES)))
    assert {scene.placement for scene in scenes} == {"clustered", "scattered", "staircase", "stepping_stones"}
    assert 8 <= sum(scene.indoor for scene in scenes) <= 32
    assert 8 <= sum(scene.world.scene.surface is None for scene in scenes) <= 32
    assert all((WALL in scene.world.classes) == scene.indoor for scene in scenes)


def test_only_pipes_and_tubes_hang_and_the_rest_stand_upright_on_a_support():
    hanging = 0
    for seed in range(30):
        world = draw(seed, placements={"scattered": 0.5, "clustered": 0.5}, hanging=0.5).world
        for g in np.flatnonzero(world.classes[: len(world.scene.kinds)] <= POLE):
            assert world.scene.rotations[g][2, 2] == pytest.approx(1)
            x, y, z = world.scene.positions[g]
            half = {"cuboid": 2, "ramp": 2, "cylinder": 2}.get(SHAPES[world.classes[g]])
            bottom = z - world.scene.sizes[g, half] if half is not None else None
            if bottom is not None and world.scene.surface is None:
                assert bottom == pytest.approx(float(world.height(x, y, below=bottom + 1e-6)), abs=1e-5)
        tops = world.tops[(world.classes == 6) | (world.classes == 7)]
        hanging += int((tops > 0.6).sum())
    assert hanging > 10


def test_a_written_layout_stands_as_it_is_written():
    scene = draw(0, placements={"written": 1}, layouts=("staircase",), indoor=0, flat_floor=1)
    assert len(scene.world.scene.kinds) == 6
    np.testing.assert_allclose(scene.world.tops[1:], 0.14 * np.arange(1, 6))


def test_the_camera_rides_at_the_trunks_height_with_jitter_in_all_six_dimensions():
    settings = SceneSettings(placements={"scattered": 1}, shapes=(0, 0), flat_floor=1, indoor=0)
    positions, forward = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        scene = draw_scene(settings, ROBOT, rng)
        poses = camera_poses(scene, ROBOT, settings.camera, 5, rng)
        way = np.array([np.cos(scene.heading), np.sin(scene.heading), 0])
        assert np.allclose(np.swapaxes(poses[:, :3, :3], 1, 2) @ poses[:, :3, :3], np.eye(3))
        assert scene.length == pytest.approx((poses[-1, :3, 3] - poses[0, :3, 3]) @ way, abs=0.15)
        positions.append(poses[:, :3, 3] - np.linspace(0, scene.length, 5)[:, None] * way)
        forward.append(poses[:, :3, 2])
    positions, forward = np.array(positions), np.array(forward)
    nominal = ROBOT.standing_height + ROBOT.camera.position[2]
    assert positions[..., 2].mean() == pytest.approx(nominal, abs=0.03)
    assert -forward[..., 2].mean() == pytest.approx(np.sin(ROBOT.camera.pitch), abs=0.05)
    assert (positions.std(axis=1).mean(axis=0) > 0.01).all()


def test_the_trunk_climbs_with_the_stairs():
    settings = SceneSettings(placements={"written": 1}, layouts=("staircase",), indoor=0, flat_floor=1)
    settings = settings.replace(camera={"speed": [1.0, 1.0], "frame_s": 0.5}, frames=6)
    rng = np.random.default_rng(0)
    scene = draw_scene(settings, ROBOT, rng)
    poses = camera_poses(scene, ROBOT, settings.camera, 6, rng)
    assert poses[-1, 2, 3] - poses[0, 2, 3] > 0.3
