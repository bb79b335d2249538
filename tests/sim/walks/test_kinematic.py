"""MuJoCo's own look at a walked path: what it must see, and what it must not."""

import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.configs.world_parts import Box
from legtool.configs.worlds import WorldSettings
from legtool.sim.walks.kinematic import walk_steps
from legtool.sim.walks.trunk_path import TrunkPath
from legtool.sim.worlds.build import build_world

PATH = TrunkPath("flat", 0.3, begin=0.0, end=0.8)


@pytest.fixture(scope="module")
def hyq():
    return load_robot("hyq")


def level(*boxes):
    return build_world(WorldSettings(name="flat", boxes=boxes))


def path(height, pitch=0.0, n=41):
    x = np.linspace(PATH.begin, PATH.end, n)
    return x, np.tile([height, 0.0, pitch], (n, 1))


def test_a_walk_on_level_ground_goes_well(hyq):
    count = walk_steps(hyq, level(), PATH, *path(0.64), frames_at=(0.2, 0.5))
    assert count.steps >= 12
    assert count.collided == count.violated == count.blind == 0
    first = count.frames[0]
    assert len(count.frames) == 2
    assert first.trunk.mean(axis=0) == pytest.approx([0.2, 0.0, 0.64], abs=0.01)
    # The links are as long as the robot's.
    assert np.linalg.norm(first.legs[:, 2] - first.legs[:, 1], axis=1) == pytest.approx(0.35, abs=1e-6)
    assert np.linalg.norm(first.legs[:, 3] - first.legs[:, 2], axis=1) == pytest.approx(0.33, abs=1e-6)


def test_a_trunk_too_high_leaves_the_workspace(hyq):
    count = walk_steps(hyq, level(), PATH, *path(0.8))
    assert count.violated > 0 and count.blind > 0


def test_a_joint_beyond_its_limit_is_a_violation_by_so_much(hyq):
    count = walk_steps(hyq, level(), PATH, *path(0.64, pitch=-0.6))
    assert count.violated > 0
    assert 0.01 < count.excess < 0.6


def test_a_wall_across_the_way_is_met(hyq):
    wall = Box(center=(0.7, 0, 0.225), size=(0.04, 2, 0.45))
    count = walk_steps(hyq, level(wall), PATH, *path(0.64))
    assert count.collided > 0
