"""Labels by face, on worlds whose answers are known."""

import numpy as np
import pytest

from legtool.configs.world_parts import SHAPES
from legtool.sim.worlds.builder import Builder
from legtool.sim.worlds.floors import FAMILY, STEEPEST, draw_floor
from legtool.sim.worlds.labels import class_image, label_image
from legtool.sim.worlds.raycast import box, camera_pose, cast, plane
from legtool.sim.worlds.shapes import Piece, draw_piece, place
from legtool.sim.worlds.surface import Surface
from legtool.sim.worlds.world import CUBOID, FLOOR, WALL
from legtool_runtime.perception import NON_PASSABLE, PASSABLE, STEPPABLE, UNKNOWN
from legtool_runtime.perception.camera import Camera
from legtool_runtime.rotations import from_angles

CAMERA = Camera.from_field_of_view(160, 120, 1.39)
POSE = camera_pose([0, 0, 0.5], pitch=0.4)
SIZES = {
    "cuboid": {"length": 0.3, "width": 0.4},
    "ramp": {"length": 0.6, "width": 0.4},
    "cylinder": {"radius": 0.2},
}


def piece(shape, height):
    match shape:
        case "sphere":
            return Piece(shape, {"radius": height / 2})
        case "semisphere":
            return Piece(shape, {"radius": height})
        case "pole":
            return Piece(shape, {"length": height, "radius": 0.02})
        case "pipe" | "tube":
            return Piece(shape, {"length": 0.6, "radius": height / 2})
    return Piece(shape, {**SIZES[shape], "height": height})


def see(builder, *, pose=POSE, limit=0.15):
    world = builder.world
    seen = cast(world.scene, CAMERA, pose, far=8.0)
    return seen, label_image(world, seen, CAMERA, pose, swing_height_max=limit), class_image(world, seen)


def put(builder, shape, height, x=1.1, y=0.0, bottom=0.0, yaw=0.4, tilt=0.0):
    one = piece(shape, height)
    builder.add(one.number, *place(one, x, y, bottom, yaw, tilt=tilt))


@pytest.mark.parametrize("shape", ("cuboid", "ramp", "cylinder"))
@pytest.mark.parametrize(("height", "side"), ((0.14, PASSABLE), (0.16, NON_PASSABLE)))
def test_the_top_face_is_steppable_and_the_others_go_by_the_riser(shape, height, side):
    builder = Builder()
    put(builder, shape, height)
    seen, labels, classes = see(builder)
    on_it = classes == SHAPES.index(shape) + 1
    top = on_it & (seen.normal[..., 2] > 0.5)
    assert top.any() and (labels[top] == STEPPABLE).all()
    assert (on_it & ~top).any() and (labels[on_it & ~top] == side).all()
    assert (labels[classes == SHAPES.index("floor") + 1] == STEPPABLE).all()


@pytest.mark.parametrize("shape", ("sphere", "semisphere", "pole", "pipe", "tube"))
@pytest.mark.parametrize(("height", "label"), ((0.14, PASSABLE), (0.16, NON_PASSABLE)))
def test_a_round_shape_goes_by_its_top_as_a_whole(shape, height, label):
    builder = Builder()
    put(builder, shape, height)
    _, labels, classes = see(builder)
    assert (labels[classes == SHAPES.index(shape) + 1] == label).all()
    assert builder.world.tops[1] == pytest.approx(height)


def test_a_round_shapes_top_is_measured_above_what_it_stands_on():
    builder = Builder()
    put(builder, "cuboid", 0.3)
    put(builder, "sphere", 0.12, bottom=0.3)
    _, labels, classes = see(builder)
    assert (labels[classes == SHAPES.index("sphere") + 1] == PASSABLE).all()


def test_a_thin_pipe_that_hangs_is_not_passable():
    builder = Builder()
    put(builder, "pipe", 0.05, bottom=0.4, tilt=0.2)
    _, labels, classes = see(builder)
    assert (labels[classes == SHAPES.index("pipe") + 1] == NON_PASSABLE).all()


def test_a_stairs_risers_are_measured_from_the_step_below_each():
    for riser, label in ((0.12, PASSABLE), (0.18, NON_PASSABLE)):
        builder = Builder()
        for i in range(3):
            length = 2.0 - 0.3 * i
            one = Piece("cuboid", {"length": length, "width": 1.0, "height": (i + 1) * riser})
            builder.add(CUBOID, *place(one, 1.0 + 0.3 * i + length / 2, 0, 0, 0))
        seen, labels, classes = see(builder, pose=camera_pose([0, 0, 0.7], pitch=0.4))
        risers = (classes == CUBOID + 1) & (seen.normal[..., 0] < -0.9)
        assert len(np.unique(seen.geom[risers])) == 3
        assert (labels[risers] == label).all()


def test_walls_are_not_passable_and_the_sky_is_unknown():
    builder = Builder()
    builder.add(WALL, plane([3, 0, 0], [[0, 0, -1], [0, -1, 0], [-1, 0, 0]], 0.3, 0), 0.0)
    seen, labels, classes = see(builder)
    assert (labels[classes == SHAPES.index("wall") + 1] == NON_PASSABLE).all()
    assert (labels[seen.geom < 0] == UNKNOWN).all() and (classes[seen.geom < 0] == 0).all() and (seen.geom < 0).any()


@pytest.mark.parametrize("name", FAMILY)
def test_a_floor_lies_on_the_ground_at_its_rim_and_is_nowhere_too_steep(name):
    for seed in range(5):
        floor = draw_floor(np.random.default_rng(seed), (1.0, 0.5), name=name)
        assert floor.heights.min() == pytest.approx(0, abs=1e-9) and 0.005 < floor.heights.max() <= 0.2
        rim = np.concatenate([floor.heights[0], floor.heights[-1], floor.heights[:, 0], floor.heights[:, -1]])
        assert np.abs(rim).max() < 1e-12
        slope = np.hypot(*np.gradient(floor.heights, floor.resolution_m))
        assert slope.max() <= STEEPEST * 1.0001
        assert np.allclose(floor.origin, [-1.0, -1.5])


def test_support_is_the_highest_carrier_below_a_limit():
    heights = np.full((11, 11), 0.05)
    builder = Builder(Surface(heights, 0.2, np.array([-1.0, -1.0])))
    put(builder, "ramp", 0.3, x=0, yaw=0.0)
    put(builder, "sphere", 0.6, x=0)
    world = builder.world
    x = np.array([0.0, 0.29, 0.8, 3.0])
    assert np.allclose(world.height(x, np.zeros(4)), [0.15, 0.295, 0.05, 0.0])
    assert float(world.height(0.29, 0.0, below=0.2)) == pytest.approx(0.05)


@pytest.mark.parametrize("shape", ("cuboid", "ramp", "cylinder", "sphere", "semisphere", "pole", "pipe", "tube"))
def test_a_drawn_shape_stands_on_its_support_inside_its_reach(shape):
    rng = np.random.default_rng(0)
    low = 0
    for _ in range(60):
        one = draw_piece(rng, shape, swing_height_max=0.15)
        builder = Builder()
        builder.add(one.number, *place(one, 0.0, 0.0, 0.0, 0.3))
        low += one.height <= 0.15
        # Seen from above, at 1 cm, it ends at its reach and its top.
        down = np.eye(4)
        down[:3, :3] = np.diag([1.0, -1.0, -1.0])
        down[2, 3] = 10.0
        seen = cast(builder.world.scene, Camera(300, 300, 1000, 1000, 149.5, 149.5), down)
        on_it = seen.geom == 1
        assert 10 - seen.depth[on_it].min() == pytest.approx(one.height, abs=0.01)
        assert builder.world.tops[1] == pytest.approx(one.height)
        v, u = np.nonzero(on_it)
        away = seen.depth[on_it] * np.hypot(u - 149.5, v - 149.5) / 1000
        assert away.max() <= one.reach + 1e-3
    assert 15 <= low <= 45


def test_a_pits_floor_is_not_steppable_and_a_label_that_is_given_counts():
    builder = Builder(floor=False)
    builder.add(FLOOR, plane([0, 0, -0.5], np.eye(3)), -0.5, ground=False)
    builder.add(CUBOID, box([0.5, 0, -0.3], np.eye(3), [0.7, 0.4, 0.3]), 0.0)
    builder.add(CUBOID, box([1.0, 0, 0.04], np.eye(3), [0.03, 0.4, 0.04]), 0.08, label=PASSABLE)
    seen, labels, _ = see(builder)
    assert (labels[seen.geom == 0] == NON_PASSABLE).all() and (seen.geom == 0).any()
    assert (labels[seen.geom == 2] == PASSABLE).all() and (seen.geom == 2).any()
    top = (seen.geom == 1) & (seen.normal[..., 2] > 0.5)
    assert (labels[top] == STEPPABLE).all() and (labels[(seen.geom == 1) & ~top] == NON_PASSABLE).all()


def test_a_slanted_boxs_upper_face_is_steppable_whichever_way_it_is_turned():
    builder = Builder()
    builder.add(CUBOID, box([1.2, 0, 0.3], from_angles(np.pi - 0.2, 0.15, 0.5), [0.3, 0.3, 0.05]), 0.42)
    seen, labels, _ = see(builder, pose=camera_pose([0, 0, 0.9], pitch=0.5))
    upper = (seen.geom == 1) & (seen.normal[..., 2] > 0.5)
    assert upper.any() and (labels[upper] == STEPPABLE).all()
