import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.configs.scenes import SceneSettings
from legtool.sim.sensors.sequence import walk_through
from legtool.sim.worlds import raycast as rc
from legtool.sim.worlds.builder import Builder
from legtool.sim.worlds.faces import face_map
from legtool.sim.worlds.floors import draw_floor
from legtool.sim.worlds.world import CUBOID, CYLINDRIC, PIPE, POLE, RAMP, SPHERIC, TUBULAR, WALL

LYING = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # local z along -y


def faces(builder, low=(-1.0, -1.0), high=(1.0, 1.0), resolution=0.01):
    return face_map(builder.world, low, high, resolution)


def at(grid, found, x, y):
    i, j = (int((a - b) / found.resolution_m) for a, b in zip((x, y), found.corner, strict=True))
    return grid[i, j]


def test_the_highest_face_is_found_with_its_height():
    builder = Builder()
    builder.add(CUBOID, rc.box([0.0, 0.0, 0.05], np.eye(3), (0.3, 0.3, 0.05)), 0.1)
    builder.add(CYLINDRIC, rc.cylinder([0.0, 0.0, 0.15], np.eye(3), 0.1, 0.05), 0.2)
    builder.add(RAMP, rc.wedge([0.7, 0.0, 0.1], np.eye(3), (0.2, 0.2, 0.1)), 0.2)
    found = faces(builder)
    assert (at(found.faces, found, 0.2, 0.2), at(found.heights, found, 0.2, 0.2)) == (1, pytest.approx(0.1))
    assert (at(found.faces, found, 0.0, 0.05), at(found.heights, found, 0.0, 0.05)) == (2, pytest.approx(0.2))
    assert (at(found.faces, found, 0.7, 0.0), at(found.heights, found, 0.7, 0.0)) == (3, pytest.approx(0.1, abs=0.006))
    assert (at(found.faces, found, -0.7, 0.7), at(found.heights, found, -0.7, 0.7)) == (0, 0.0)
    assert found.free.all() and found.surface == -1


@pytest.mark.parametrize(
    ("shape", "primitive", "footprint"),
    [
        (SPHERIC, rc.sphere([0.0, 0.0, 0.1], 0.1), np.pi * (0.1**2 - 0.09**2)),
        (POLE, rc.capsule([0.0, 0.0, 0.2], np.eye(3), 0.05, 0.2), np.pi * 0.05**2),
        # 1 cm above the ground a pipe's axis is 4 cm higher: its chord there is 6 cm wide.
        (PIPE, rc.cylinder([0.0, 0.0, 0.05], LYING, 0.05, 0.4), 0.06 * 0.8),
        (TUBULAR, rc.tube([0.0, 0.0, 0.05], LYING, 0.05, 0.04, 0.4), 0.06 * 0.8),
    ],
)
def test_what_stands_on_a_face_is_no_place_for_a_foot(shape, primitive, footprint):
    builder = Builder()
    builder.add(shape, primitive, 0.2)
    found = faces(builder, resolution=0.005)
    assert (~found.free).sum() * 0.005**2 == pytest.approx(footprint, rel=0.06)
    assert not at(found.free, found, 0.001, 0.001)


def test_what_hangs_leaves_the_floor_below_free_and_a_wall_ends_it():
    builder = Builder()
    builder.add(PIPE, rc.cylinder([0.0, 0.0, 0.6], LYING, 0.05, 0.4), 0.65)
    assert faces(builder).free.all()
    builder.add(WALL, rc.plane([0.5, 0, 0], np.column_stack([[0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]])), 0.0)
    builder.add(WALL, rc.plane([0, 0, 2.5], np.diag([1.0, -1.0, -1.0])), 0.0)
    found = faces(builder)
    assert at(found.free, found, 0.4, 0.0) and not at(found.free, found, 0.6, 0.0)


def test_a_floor_that_is_not_flat_is_a_face_of_its_own():
    floor = draw_floor(np.random.default_rng(0), (0.0, 0.0), name="mounds")
    found = faces(Builder(floor))
    assert found.surface == 1
    i, j = np.argwhere(found.faces == 1)[100]
    x, y = found.corner + (np.array([i, j]) + 0.5) * found.resolution_m
    assert found.heights[i, j] == pytest.approx(floor.height(x, y))


def test_a_walks_poses_belong_together_and_repeat():
    robot = load_robot("go2").replace(camera={"width": 64, "height": 48})
    settings = SceneSettings(seed=3, scenes=1, frames=3)
    drawn, steps = walk_through(settings, robot, 0)
    _, again = walk_through(settings, robot, 0)
    for step, same in zip(steps, again, strict=True):
        np.testing.assert_array_equal(step.view.depth, same.view.depth)
        np.testing.assert_array_equal(step.base_to_world, same.base_to_world)
        inside = np.linalg.inv(step.base_to_world) @ step.camera_to_world
        np.testing.assert_allclose(inside[:3, 3], robot.camera.position, atol=1e-9)
        assert np.arcsin(-inside[2, 2]) == pytest.approx(robot.camera.pitch)
        assert step.view.seen.depth.shape == step.view.label.shape == (48, 64)
    assert drawn.length > 0


def test_where_nothing_is_there_is_no_face_and_a_pits_floor_is_not_free():
    builder = Builder(floor=False)
    builder.add(CUBOID, rc.box([0.0, 0.0, -0.1], np.eye(3), (0.3, 0.3, 0.1)), 0.0)
    builder.add(CUBOID, rc.box([0.6, 0.0, -0.6], np.eye(3), (0.3, 0.3, 0.1)), -0.5, ground=False)
    found = faces(builder)
    assert (at(found.faces, found, -0.7, 0.7), at(found.free, found, -0.7, 0.7)) == (-1, False)
    assert at(found.heights, found, -0.7, 0.7) == -np.inf
    assert (at(found.faces, found, 0.6, 0.0), at(found.free, found, 0.6, 0.0)) == (1, False)
    assert at(found.free, found, 0.0, 0.0)
