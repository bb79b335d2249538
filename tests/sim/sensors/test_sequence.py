import numpy as np

from legtool.configs.robots import load_robot
from legtool.sim.sensors import sequence
from legtool.sim.worlds.builder import Builder
from legtool.sim.worlds.placement import DrawnScene
from legtool.sim.worlds.raycast import box, camera_pose, cast
from legtool.sim.worlds.world import CUBOID


def test_a_view_leaves_the_exact_image_as_it_is(monkeypatch):
    builder = Builder()
    builder.add(CUBOID, box([0.3, 0, 0.4], np.eye(3), [0.1, 0.1, 0.4]), 0.8)
    robot = load_robot("go2").replace(camera={"width": 64, "height": 48, "range_m": [0.3, 5.0]})
    kept = []
    monkeypatch.setattr(sequence, "cast", lambda *a, **k: kept.append(cast(*a, **k)) or kept[-1])
    drawn = DrawnScene(builder.world, "scattered", False, 0.0, 1.0)
    pose = camera_pose([0, 0, 0.5], pitch=0.3)
    seen = sequence.view(drawn, robot, robot.camera.camera(), pose, (), np.random.default_rng(0)).seen
    exact = kept[0].depth
    near = exact < 0.3
    assert near.any() and np.isnan(seen.depth[near]).all()
    np.testing.assert_array_equal(seen.depth[~near], exact[~near])
