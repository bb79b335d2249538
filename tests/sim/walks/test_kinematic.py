"""MuJoCo's own look at a walked path: what it must see, and what it must not."""

import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.sim.walks.kinematic import boxes, walk_steps
from legtool.sim.worlds.foothold_courses import Walk, course_heights
from legtool_runtime.terrain.elevation import HeightMap

WALK = Walk("flat", 0.3, begin=0.0, end=0.8)


@pytest.fixture(scope="module")
def hyq():
    return load_robot("hyq")


def level(height=0.0):
    return HeightMap(np.full((200, 100), height, np.float32), 0.02, np.array([0.6, 0.0]))


def path(height, pitch=0.0, n=41):
    x = np.linspace(WALK.begin, WALK.end, n)
    return x, np.tile([height, 0.0, pitch], (n, 1))


def test_a_walk_on_level_ground_goes_well(hyq):
    count = walk_steps(hyq, level(), WALK, *path(0.64), frames_at=(0.2, 0.5))
    assert count.steps >= 12
    assert count.collided == count.violated == count.blind == 0
    first = count.frames[0]
    assert len(count.frames) == 2
    assert first.trunk.mean(axis=0) == pytest.approx([0.2, 0.0, 0.64], abs=0.01)
    # The links are as long as the robot's.
    assert np.linalg.norm(first.legs[:, 2] - first.legs[:, 1], axis=1) == pytest.approx(0.35, abs=1e-6)
    assert np.linalg.norm(first.legs[:, 3] - first.legs[:, 2], axis=1) == pytest.approx(0.33, abs=1e-6)


def test_a_trunk_too_high_leaves_the_workspace(hyq):
    count = walk_steps(hyq, level(), WALK, *path(0.8))
    assert count.violated > 0 and count.blind > 0


def test_a_joint_beyond_its_limit_is_a_violation_by_so_much(hyq):
    count = walk_steps(hyq, level(), WALK, *path(0.64, pitch=-0.6))
    assert count.violated > 0
    assert 0.01 < count.excess < 0.6


def test_a_wall_across_the_way_is_met(hyq):
    wall = level()
    wall.heights[105:107, :] = 0.45
    count = walk_steps(hyq, wall, WALK, *path(0.64))
    assert count.collided > 0


def test_the_terrain_of_boxes_is_the_map():
    for name in ("gapped_stairs", "rough"):
        heights = course_heights(name).heights
        built = np.full_like(heights, np.nan)
        for (i0, i1, j0, j1), top in boxes(heights):
            assert np.isnan(built[i0:i1, j0:j1]).all()
            built[i0:i1, j0:j1] = top
        assert np.array_equal(built, heights)
