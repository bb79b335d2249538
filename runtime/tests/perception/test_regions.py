import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception import NON_PASSABLE, STEPPABLE
from legtool_runtime.perception.camera import Camera, as_metres
from legtool_runtime.perception.egocan import CanImage, Egocan, EgocanSettings
from legtool_runtime.perception.normals import normals
from legtool_runtime.perception.regions import RegionSettings, convex_regions
from legtool_runtime.perception.superpixels import SuperpixelSettings, oversegment

SETTINGS = SuperpixelSettings(number=80, least=12)
STONES = [((0.1, -0.13, 0.1), (0.1, 0.1, 0.1), 0.0), ((0.1, 0.13, 0.1), (0.1, 0.1, 0.1), 0.0)]


def inside(boundary, spacing=0.004):
    """Points (n, 2) of a grid within a convex polygon."""
    low, high = boundary.min(axis=0), boundary.max(axis=0)
    grid = np.stack(np.meshgrid(*[np.arange(a, b, spacing) for a, b in zip(low, high, strict=True)]), -1).reshape(-1, 2)
    edges = np.roll(boundary, -1, axis=0) - boundary
    offset = grid[:, None] - boundary
    return grid[(edges[:, 0] * offset[..., 1] - edges[:, 1] * offset[..., 0] >= 0).all(axis=1)]


def to_world(regions, index, points):
    return points @ regions.poses[index, :3, :2].T + regions.poses[index, :3, 3]


def on_box(points, centre, half, yaw):
    """Distance outside the top of a box, 0 on it [m]."""
    c, s = np.cos(yaw), np.sin(yaw)
    local = (points[:, :2] - centre[:2]) @ np.array([[c, -s], [s, c]])
    return np.maximum(np.abs(local) - half[:2], 0).max(axis=1)


def plane_image(normal, height=0.8, side=96, focal=80.0):
    """The floor image of one tilted plane under the can, filling it."""
    middle = 0.5 * side - 0.5
    ix, iy = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    rays = np.stack([(ix - middle) / focal, (iy - middle) / focal, -np.ones((side, side))], -1)
    points = rays * (-height * normal[2] / (rays @ normal))[..., None]
    pose = np.eye(4)
    c, s = np.cos(0.7), np.sin(0.7)
    pose[:2, :2], pose[:3, 3] = [[c, -s], [s, c]], [1.0, 2.0, 0.8]
    normals = np.broadcast_to(normal, points.shape)
    labels = np.full((side, side), STEPPABLE, np.uint8)
    return CanImage(points.astype(np.float32), normals.astype(np.float32), labels, focal, pose)


@pytest.mark.parametrize("normal", [[0, 0, 1.0], [0.3, 0.1, 0.9], [-0.4, 0.3, 0.8]])
def test_regions_of_a_plane_lie_in_it_and_cover_it(normal):
    normal = np.array(normal) / np.linalg.norm(normal)
    floor = plane_image(normal)
    regions = convex_regions(oversegment(floor, SETTINGS))
    rotation = floor.transform_to_world[:3, :3]
    assert len(regions) > 50
    np.testing.assert_allclose(regions.poses[:, :3, 2], np.tile(rotation @ normal, (len(regions), 1)), atol=2e-3)
    for k in range(len(regions)):
        levelled = (regions.corners_world(k) - floor.transform_to_world[:3, 3]) @ rotation
        assert np.abs((levelled - [0, 0, -0.8]) @ normal).max() < 1e-3
        np.testing.assert_allclose(regions.poses[k, :3, :3].T @ regions.poses[k, :3, :3], np.eye(3), atol=1e-9)
        assert np.linalg.det(regions.poses[k, :3, :3]) == pytest.approx(1.0)
    corners = np.stack([floor.points[a, b] for a, b in ((0, 0), (0, -1), (-1, -1), (-1, 0))]).astype(float)
    whole = 0.5 * abs(
        np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
        + np.linalg.norm(np.cross(corners[2] - corners[0], corners[3] - corners[0]))
    )
    assert 0.8 * whole < regions.areas.sum() < 1.02 * whole


def test_boundaries_are_convex_counter_clockwise_and_enclose_their_area(seen_from_above):
    regions = convex_regions(oversegment(seen_from_above(boxes=STONES), SETTINGS))
    for boundary, area in zip(regions.boundaries, regions.areas, strict=True):
        edges = np.roll(boundary, -1, axis=0) - boundary
        after = np.roll(edges, -1, axis=0)
        assert (edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0] > -1e-9).all()
        x, y = boundary.T
        assert area == pytest.approx(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))
        assert area >= RegionSettings().least_area
        # The origin is the superpixel's centroid.
        assert np.linalg.norm(boundary.mean(axis=0)) < 0.1


def test_regions_lie_wholly_on_one_face(seen_from_above):
    boxes = [*STONES, ((-0.4, 0.0, 0.03), (0.15, 0.3, 0.03), 0.4)]
    regions = convex_regions(oversegment(seen_from_above(boxes=boxes), SETTINGS))
    tops = 0
    for k in range(len(regions)):
        points = to_world(regions, k, np.vstack([inside(regions.boundaries[k]), regions.boundaries[k]]))
        height = regions.poses[k, 2, 3]
        over = {n: on_box(points, *box) for n, box in enumerate(boxes)}
        if height > 0.01:
            mine = [n for n, box in enumerate(boxes) if abs(2 * box[1][2] - height) < 1e-3 and over[n].max() < 1e-3]
            reach = {n: distance.max() for n, distance in over.items()}
            assert len(mine) == 1, f"region {k} at height {height} leaves its face by {reach}"
            tops += 1
        else:
            assert all((distance > 0).mean() > 0.99 for distance in over.values())
    assert tops >= 6


def test_a_gap_that_nothing_was_seen_of_is_measured_and_cut_out():
    # 4 cm wide, and so placed that the squares that connect a superpixel's pixels touch across it.
    floor = plane_image(np.array([0.0, 0.0, 1.0]))
    floor.points[:, 46:50] = np.nan
    low, high = floor.points[50, 45, 1], floor.points[50, 50, 1]
    superpixels = oversegment(floor, SuperpixelSettings(number=25))

    def across(regions):
        """Position of every region's points across the gap [m]."""
        return [
            ((to_world(regions, k, boundary) - floor.transform_to_world[:3, 3]) @ floor.transform_to_world[:3, 1])
            for k, boundary in enumerate(map(inside, regions.boundaries))
        ]

    hulls = convex_regions(superpixels, RegionSettings(trim=False))
    spanning = [k for k, y in enumerate(across(hulls)) if y.min() < low and y.max() > high]
    assert spanning, "no superpixel spans the gap: the test shows nothing"
    for k in spanning:
        over = ((across(hulls)[k] > low) & (across(hulls)[k] < high)).mean() * hulls.areas[k]
        assert hulls.overhang[k] == hulls.trimmed[k]
        assert hulls.overhang[k] == pytest.approx(over, rel=0.25)
    regions = convex_regions(superpixels)
    assert regions.overhang.sum() == 0
    assert regions.trimmed.sum() == pytest.approx(hulls.overhang.sum())
    for y in across(regions):
        assert not ((y > low + 1e-6) & (y < high - 1e-6)).any()


def test_a_hole_that_shows_lower_ground_is_cut_out(seen_from_above):
    # A plateau of four boxes around a hole of 12 cm.
    boxes = [
        ((x, y, 0.1), half, 0.0)
        for x, y, half in (
            (0.25, 0.0, (0.19, 0.3, 0.1)),
            (-0.25, 0.0, (0.19, 0.3, 0.1)),
            (0.0, 0.18, (0.06, 0.12, 0.1)),
            (0.0, -0.18, (0.06, 0.12, 0.1)),
        )
    ]
    superpixels = oversegment(seen_from_above(boxes=boxes), SuperpixelSettings(number=10))
    regions = convex_regions(superpixels)
    hulls = convex_regions(superpixels, RegionSettings(trim=False))
    assert hulls.overhang.max() > 0.002
    for k in range(len(regions)):
        if regions.poses[k, 2, 3] > 0.1:
            points = to_world(regions, k, inside(regions.boundaries[k]))
            assert (np.abs(points[:, :2]).max(axis=1) > 0.06 - 0.016).all()


def test_a_speck_of_noise_does_not_cost_a_region(seen_from_above):
    floor = seen_from_above()
    rng = np.random.default_rng(0)
    specks = rng.integers(0, 128, (150, 2))
    floor.points[specks[:, 0], specks[:, 1], 2] += 0.05
    superpixels = oversegment(floor, SETTINGS)
    assert (
        convex_regions(superpixels).areas.sum()
        > 0.97 * convex_regions(oversegment(seen_from_above(), SETTINGS)).areas.sum()
    )


def test_what_noise_smears_from_tread_to_tread_is_no_ground(world):
    # Going down, each tread hides part of the next. Past its edge the sensor smears the jump in depth over some pixels:
    # points along the rays, which together with the edges make one fine plane down the whole stairs.
    going, heights = 0.4, np.array([1.2, 1.0, 0.8, 0.6, 0.4, 0.2, 0.0])
    boxes = [((going * (k - 0.5), 0.0, h / 2), (going / 2, 1.2, h / 2), 0.0) for k, h in enumerate(heights[:-1])]
    camera = Camera.from_field_of_view(320, 240, np.deg2rad(80))
    base, pose = np.eye(4), world.camera_pose([-0.05, 0.0, 1.65], 0.5)
    base[:3, 3] = -0.3, 0.0, 1.6
    depth, _, face = world.render(camera, pose, boxes=boxes)
    noisy = depth * (1 + 0.01 * np.random.default_rng(0).standard_normal(depth.shape))
    depth = as_metres(gaussian_filter(noisy, 2.0).astype(np.float32), camera)
    labels = np.where((face == 0) | (face % 10 == 2), STEPPABLE, NON_PASSABLE).astype(np.uint8)
    can = Egocan(EgocanSettings(lift=0.3))
    can.move(base)
    can.insert(depth, normals(depth, camera, reach=3), camera=camera, transform_camera_to_world=pose, labels=labels)
    regions = convex_regions(oversegment(can.floor()))
    points = [to_world(regions, k, inside(regions.boundaries[k])) for k in range(len(regions))]
    assert sum((np.abs(p[:, 2] - 1.0) < 0.02).all() for p in points) > 2, "no next tread: the test shows nothing"
    x, z = np.concatenate(points)[:, [0, 2]].T
    ground = heights[np.clip(np.ceil(x / going), 0, 6).astype(int)]
    assert np.mean(np.abs(z - ground) > 0.03) < 0.08


def test_regions_too_small_for_a_foot_are_left_out(seen_from_above):
    superpixels = oversegment(seen_from_above(boxes=STONES), SETTINGS)
    everything = convex_regions(superpixels, RegionSettings(least_area=0.0))
    large = convex_regions(superpixels, RegionSettings(least_area=0.02))
    assert 0 < len(large) < len(everything)
    assert large.areas.min() > 0.02
    assert set(large.ids) <= set(everything.ids)


def test_noise_moves_heights_and_normals_little(seen_from_above):
    regions = convex_regions(oversegment(seen_from_above(boxes=STONES, noise=0.001), SETTINGS))
    height = regions.poses[:, 2, 3]
    error = np.abs(height[:, None] - [0.0, 0.2]).min(axis=1)
    assert np.median(error) < 0.002
    assert np.rad2deg(np.arccos(np.median(regions.poses[:, 2, 2]))) < 2


@pytest.mark.parametrize("setting", [{"tolerance": 0.0}, {"tolerance": 1.0}, {"least_area": -1.0}])
def test_settings_out_of_range_are_refused(setting):
    with pytest.raises(PerceptionError, match=r"regions: .* expected"):
        RegionSettings(**setting)
