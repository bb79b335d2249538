import numpy as np
import pytest

from legtool_runtime.errors import MapError
from legtool_runtime.terrain import ElevationGrid, ElevationSettings, HeightMap, foot_costmap, warm_up

R = 0.02
CAMERA = (385.0, 385.0, 319.5, 239.5)
SIZE = (480, 640)
FLOOR = ((-9, -9, -2), (9, 9, 0))


def pose(position=(0.0, 0.0, 0.5), pitch=0.6, yaw=0.0):
    """An optical frame that looks forward and down."""
    c, s, cy, sy = np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    forward, right = np.array([cy * c, sy * c, -s]), np.array([sy, -cy, 0.0])
    out = np.eye(4)
    out[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    out[:3, 3] = position
    return out


def render(boxes, transform, camera=CAMERA, size=SIZE):
    """Depth of the first hit of each pixel's ray with axis-aligned boxes (lower corner, upper corner)."""
    fx, fy, cx, cy = camera
    u, v = np.meshgrid(np.arange(size[1]), np.arange(size[0]))
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.shape)], axis=-1) @ transform[:3, :3].T
    depth = np.full(size, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for low, high in boxes:
            a, b = (low - transform[:3, 3]) / rays, (high - transform[:3, 3]) / rays
            enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
            depth = np.where((enter < leave) & (enter > 0), np.minimum(depth, enter), depth)
    return np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)


def noisy(depth, rng, share=0.004):
    return (depth + share * depth**2 * rng.normal(size=depth.shape)).astype(np.float32)


def fused(boxes, transform=None, frames=1, grid=None, seed=None):
    grid = grid or ElevationGrid()
    transform = pose() if transform is None else transform
    rng = np.random.default_rng(seed)
    for k in range(frames):
        image = render(boxes, transform)
        if seed is not None:
            image = noisy(image, rng)
        grid.update(image, CAMERA, transform_camera_to_world=transform, time_s=0.1 * k)
    return grid


def height_at(grid, x, y):
    cells = grid.map()
    ix, iy = np.floor((np.array([x, y]) - cells.lower_corner) / cells.resolution_m).astype(int)
    return cells.heights[ix, iy]


def axis(grid):
    cells = grid.map()
    return cells.center[0] + (np.arange(cells.heights.shape[0]) - (cells.heights.shape[0] - 1) / 2) * cells.resolution_m


def test_flat_ground_is_flat_and_its_variance_known():
    cells = fused([FLOOR], frames=10, seed=0).map()
    seen = ~np.isnan(cells.heights)
    assert seen.sum() > 3000
    assert np.abs(cells.heights[seen]).max() < 0.01 and np.sqrt(np.mean(cells.heights[seen] ** 2)) < 0.002
    assert (cells.variance[seen] > 0).all() and np.isnan(cells.variance[~seen]).all()


def test_what_lies_behind_the_camera_or_out_of_reach_is_unknown():
    grid = fused([FLOOR])
    assert np.isnan(height_at(grid, -0.5, 0.0)) and np.isnan(height_at(grid, 0.1, 0.0))
    assert height_at(grid, 1.0, 0.0) == pytest.approx(0.0, abs=1e-3)


def test_a_step_keeps_its_edge_without_heights_in_between():
    step = ((1.0, -9, -2), (9, 9, 0.06))
    grid = fused([FLOOR, step])
    x, row = axis(grid), grid.map().heights[:, 100]
    known = ~np.isnan(row)
    np.testing.assert_allclose(row[known & (x < 0.99)], 0.0, atol=1e-3)
    np.testing.assert_allclose(row[known & (x > 1.01) & (x < 1.8)], 0.06, atol=1e-3)


def test_with_noise_an_edge_stays_within_two_cells_and_no_height_is_invented():
    grid = fused([FLOOR, ((1.0, -9, -2), (9, 9, 0.06))], frames=10, seed=1)
    x, rows = axis(grid), grid.map().heights[:, 80:120]
    assert np.nanmax(np.abs(rows[x < 0.955])) < 0.012
    near = rows[(x > 1.01) & (x < 1.4)]
    assert np.nanmin(near) > 0.045 and np.nanmax(near) < 0.07


def test_the_floor_that_an_obstacle_hides_is_unknown():
    grid = fused([FLOOR, ((0.8, -0.3, 0), (1.0, 0.3, 0.2))])
    assert height_at(grid, 0.9, 0.0) == pytest.approx(0.2, abs=2e-3)
    assert np.isnan(height_at(grid, 1.2, 0.0))
    assert height_at(grid, 1.0, 0.5) == pytest.approx(0.0, abs=2e-3)


def test_a_gap_that_hides_its_floor_is_unknown_inside_and_unsafe_in_the_costmap():
    sides = [((-9, -9, -2), (0.8, 9, 0)), ((0.95, -9, -2), (9, 9, 0))]
    grid = fused(sides, frames=8, seed=2)
    x, rows = axis(grid), grid.map().heights[:, 90:110]
    assert np.isnan(rows[(x > 0.83) & (x < 0.91)]).all()
    unsafe = foot_costmap(grid.map()).unsafe[:, 90:110]
    assert unsafe[(x > 0.83) & (x < 0.92)].all() and not unsafe[(x > 0.6) & (x < 0.75)].any()


def test_the_map_moves_with_the_robot_and_keeps_what_stays_inside():
    grid = fused([FLOOR, ((0.8, -0.3, 0), (1.0, 0.3, 0.2))], seed=3)
    before = grid.map()
    rng = np.random.default_rng(0)
    for _ in range(30):
        grid.move_to(rng.uniform(-0.4, 0.4, 2))
    shift = (0.37, -0.21)
    grid.move_to(shift)
    after = grid.map()
    for x, y in rng.uniform(-1.5, 1.5, (200, 2)):
        values = []
        for cells in (before, after):
            ix, iy = np.floor((np.array([x, y]) - cells.lower_corner) / R + 1e-9).astype(int)
            values.append(cells.heights[ix, iy])
        np.testing.assert_equal(*values)
    np.testing.assert_allclose(after.center, shift, atol=R / 2 + 1e-9)
    entering = after.heights[-10:]
    assert np.isnan(entering[:, :30]).all()


def test_moving_far_away_empties_the_map_and_coming_back_does_not_bring_it_back():
    grid = fused([FLOOR])
    grid.move_to((100.0, -100.0))
    assert np.isnan(grid.map().heights).all()
    grid.move_to((0.0, 0.0))
    assert np.isnan(grid.map().heights).all()


def test_the_same_world_far_from_the_origin_gives_the_same_map():
    offset = np.array([123.4, -56.78, 3.2])
    there = [tuple(np.array(corner) + offset for corner in box) for box in (FLOOR, ((0.8, -0.3, 0), (1.0, 0.3, 0.2)))]
    moved = ElevationGrid(center=offset[:2])
    fused(there, pose(offset + np.array([0, 0, 0.5])), grid=moved)
    assert height_at(moved, offset[0] + 0.9, offset[1]) == pytest.approx(3.4, abs=3e-3)
    assert height_at(moved, offset[0] + 0.6, offset[1]) == pytest.approx(3.2, abs=3e-3)


def test_something_that_goes_away_is_forgotten_after_a_while():
    box = ((0.8, -0.3, 0), (1.0, 0.3, 0.2))
    grid = fused([FLOOR, box])
    empty = render([FLOOR], pose())
    for time in (0.1, 0.5, 1.0):
        grid.update(empty, CAMERA, transform_camera_to_world=pose(), time_s=time)
        assert height_at(grid, 0.9, 0.0) == pytest.approx(0.2, abs=2e-3)
    grid.update(empty, CAMERA, transform_camera_to_world=pose(), time_s=1.2)
    assert height_at(grid, 0.9, 0.0) == pytest.approx(0.0, abs=2e-3)


def test_something_higher_replaces_the_ground_at_once():
    grid = fused([FLOOR], frames=5)
    fused([FLOOR, ((0.8, -0.3, 0), (1.0, 0.3, 0.1))], grid=grid)
    assert height_at(grid, 0.9, 0.0) == pytest.approx(0.1, abs=2e-3)


def test_mixed_pixels_at_edges_are_left_out():
    image = render([FLOOR], pose())
    image[200:400:7, 100:500:11] *= 0.5  # lone pixels in mid-air
    grid = ElevationGrid()
    grid.update(image, CAMERA, transform_camera_to_world=pose(), time_s=0.0)
    assert np.nanmax(grid.map().heights) < 0.01


def test_grazing_rows_of_pixels_are_joined():
    camera, size = (168.0, 168.0, 159.5, 119.5), (240, 320)
    image = render([FLOOR], pose(), camera, size)
    holes = []
    for bridge in (0.0, 0.05):
        grid = ElevationGrid(ElevationSettings(bridge_m=bridge))
        grid.update(image, camera, transform_camera_to_world=pose(), time_s=0.0)
        x, rows = axis(grid), grid.map().heights[:, 90:110]
        holes.append(np.isnan(rows[(x > 1.2) & (x < 1.8)]).mean())
    assert holes[0] > 0.15 and holes[1] < 0.03


def test_millimetres_and_metres_give_the_same_map():
    image = render([FLOOR], pose())
    maps = []
    for depth in (image, np.round(image * 1000).astype(np.uint16), image.astype(np.float64)):
        grid = ElevationGrid()
        grid.update(depth, CAMERA, transform_camera_to_world=pose(), time_s=0.0)
        maps.append(grid.map().heights)
    np.testing.assert_array_equal(maps[0], maps[2])
    both = ~np.isnan(maps[0]) & ~np.isnan(maps[1])
    assert both.sum() > 0.98 * (~np.isnan(maps[0])).sum()
    assert np.quantile(np.abs(maps[0] - maps[1])[both], 0.99) < 0.004


def test_ground_that_is_assumed_gives_way_to_what_is_seen():
    grid = ElevationGrid()
    grid.assume_flat((0.0, 0.0), radius_m=0.9, height_m=0.03)
    assert height_at(grid, 0.0, 0.0) == pytest.approx(0.03) and np.isnan(height_at(grid, 0.95, 0.0))
    fused([FLOOR], grid=grid)
    assert height_at(grid, 0.7, 0.0) == pytest.approx(0.0, abs=2e-3)
    assert height_at(grid, -0.7, 0.0) == pytest.approx(0.03)
    grid.assume_flat((0.0, 0.0), radius_m=0.9, height_m=1.0)
    assert height_at(grid, 0.7, 0.0) == pytest.approx(0.0, abs=2e-3)


def test_an_image_without_returns_tells_nothing():
    grid = ElevationGrid()
    for image in (np.zeros(SIZE, np.float32), np.full(SIZE, np.nan, np.float32), np.full(SIZE, np.inf, np.float32)):
        assert grid.update(image, CAMERA, transform_camera_to_world=pose(), time_s=0.0) == 0
    assert np.isnan(grid.map().heights).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"depth": np.zeros(10)}, "depth: shape"),
        ({"depth": np.zeros((10, 10), np.int32)}, "int32 values"),
        ({"intrinsics": (1, 2, 3)}, "intrinsics"),
        ({"intrinsics": (-1, 2, 3, 4)}, "expected positive"),
        ({"transform_camera_to_world": np.eye(3)}, "transform_camera_to_world"),
        ({"transform_camera_to_world": np.diag([1, 1, -1, 1])}, "no rigid transform"),
        ({"transform_camera_to_world": np.full((4, 4), np.nan)}, "finite"),
        ({"time_s": np.inf}, "time_s"),
    ],
)
def test_bad_input_is_named_and_leaves_the_map_as_it_was(change, words):
    grid = fused([FLOOR])
    before = grid.map().heights
    inputs = {
        "depth": np.ones(SIZE),
        "intrinsics": CAMERA,
        "transform_camera_to_world": pose(),
        "time_s": 1.0,
        **change,
    }
    with pytest.raises(MapError, match=words):
        grid.update(inputs.pop("depth"), inputs.pop("intrinsics"), **inputs)
    np.testing.assert_array_equal(grid.map().heights, before)


@pytest.mark.parametrize("change", [{"size_m": 0.01}, {"gate": np.nan}, {"min_range_m": 4.0}, {"resolution_m": 0.0}])
def test_settings_out_of_range_are_refused(change):
    with pytest.raises(MapError, match=next(iter(change))):
        ElevationSettings(**change)


def test_a_map_that_was_moved_to_nowhere_stays():
    grid = ElevationGrid()
    with pytest.raises(MapError, match="center"):
        grid.move_to((np.nan, 0.0))


def test_warming_up_leaves_nothing_to_compile():
    warm_up()
    warm_up()


def test_a_ready_map_is_taken_as_it_is():
    cells = HeightMap(np.zeros((50, 40)), R, (1.0, 2.0))
    np.testing.assert_allclose(cells.lower_corner, [0.5, 1.6])


def approach(settings):
    """A noisy camera that comes up to a 10 cm gap at x = 1.2 m in a floor over a pit."""
    near, far, pit = ((-9, -9, -2), (1.2, 9, 0)), ((1.3, -9, -2), (9, 9, 0)), ((-9, -9, -2), (9, 9, -0.3))
    grid = ElevationGrid(settings, center=(1.0, 0.0))
    rng = np.random.default_rng(1)
    small, camera = (240, 320), (193.0, 193.0, 159.5, 119.5)
    for k in range(40):
        transform = pose((-0.3 + 0.02 * k, 0.0, 0.43), pitch=0.5)
        image = noisy(render([near, far, pit], transform, camera, small), rng)
        grid.update(image, camera, transform_camera_to_world=transform, time_s=k / 15)
    return grid


def test_range_noise_does_not_build_ground_out_over_a_gap():
    grid = approach(None)
    over_gap = [height_at(grid, x, y) for x in (1.23, 1.25, 1.27) for y in np.arange(-0.2, 0.2, 0.02)]
    assert not (np.array(over_gap) > -0.05).any()
    beyond = [height_at(grid, x, y) for x in (1.35, 1.4) for y in np.arange(-0.2, 0.2, 0.02)]
    np.testing.assert_allclose(beyond, 0.0, atol=0.02)


def test_without_the_share_of_pixels_noise_would_narrow_the_gap():
    ground = approach(ElevationSettings(support=0.0))
    assert any(height_at(ground, 1.27, y) > -0.05 for y in np.arange(-0.2, 0.2, 0.02))


def test_points_are_the_middles_of_the_known_cells_around_a_place():
    heights = np.arange(30, dtype=np.float32).reshape(5, 6)
    heights[2, 3] = np.nan
    grid = HeightMap(heights, 0.1, np.array([1.0, 2.0]))
    every = grid.points((1.0, 2.0), within_m=5.0)
    assert every.shape == (29, 3)
    np.testing.assert_allclose(every[0], [0.8, 1.75, 0.0], atol=1e-6)
    np.testing.assert_allclose(every[-1], [1.2, 2.25, 29.0], atol=1e-6)
    near = grid.points((0.8, 1.75), within_m=0.11)
    np.testing.assert_allclose(near, [[0.8, 1.75, 0], [0.8, 1.85, 1], [0.9, 1.75, 6], [0.9, 1.85, 7]], atol=1e-6)
    assert grid.points((50.0, 2.0), within_m=1.0).shape == (0, 3)
