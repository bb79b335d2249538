from dataclasses import replace

import numpy as np
import pytest

from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception import NON_PASSABLE, PASSABLE, STEPPABLE, UNKNOWN
from legtool_runtime.perception import superpixel_kernels as kernels
from legtool_runtime.perception import superpixel_planes as planes
from legtool_runtime.perception.egocan import Egocan, EgocanSettings
from legtool_runtime.perception.superpixels import (
    ASSUMED,
    EMPTY,
    HEALTHY,
    REMOVED,
    FloorGround,
    SuperpixelSettings,
    oversegment,
)

SETTINGS = SuperpixelSettings(number=80, least=12)
BOXES = [((0.4, 0.1, 0.04), (0.2, 0.15, 0.04), 0.3), ((-0.4, -0.2, 0.08), (0.15, 0.2, 0.08), -0.2)]


def heights(superpixels):
    """Height above the ground of each member, by superpixel [m]."""
    z = superpixels.channels[2] + 0.8
    return [z[superpixels.order[a:b]] for a, b in zip(superpixels.start, superpixels.start[1:], strict=False)]


def test_a_flat_floor_is_divided_into_about_the_wanted_number_of_even_pieces(seen_from_above):
    superpixels = oversegment(seen_from_above(), SETTINGS)
    # The can fills the circle in its square floor image.
    assert 0.7 * 80 * np.pi / 4 < len(superpixels) < 1.3 * 80 * np.pi / 4
    sizes = np.diff(superpixels.start)
    assert np.percentile(sizes, 90) < 3 * np.percentile(sizes, 25)
    healthy = superpixels.state == HEALTHY
    assert (superpixels.assignment[healthy] >= 0).mean() > 0.99
    assert (superpixels.assignment[~healthy] == -1).all()


def test_no_superpixel_holds_pixels_of_two_faces(seen_from_above):
    superpixels = oversegment(seen_from_above(boxes=BOXES), SETTINGS)
    spread = np.array([np.ptp(z) for z in heights(superpixels)])
    assert spread.max() < 1e-3
    levels = np.unique(np.round([z.mean() for z in heights(superpixels)], 3))
    np.testing.assert_allclose(levels, [0.0, 0.08, 0.16], atol=1e-6)


def test_a_face_smaller_than_the_distance_between_seeds_still_gets_a_superpixel(seen_from_above):
    stones = [((x, y, 0.05), (0.045, 0.045, 0.05), 0.0) for x in (-0.33, 0.0, 0.37) for y in (-0.31, 0.05, 0.3)]
    superpixels = oversegment(seen_from_above(boxes=stones), SETTINGS)
    tops = [p for p, z in zip(superpixels.points, heights(superpixels), strict=True) if z.mean() > 0.09]
    for centre, _, _ in stones:
        assert min(np.linalg.norm(p[:2] - centre[:2]) for p in tops) < 0.03


def test_a_superpixel_is_connected(seen_from_above):
    stones = [((0.1, y, 0.1), (0.1, 0.1, 0.1), 0.0) for y in (-0.15, 0.15)]
    superpixels = oversegment(seen_from_above(boxes=stones), SuperpixelSettings(number=8))
    sides = [
        set(np.sign(superpixels.channels[1, superpixels.order[a:b]]))
        for a, b, z in zip(superpixels.start, superpixels.start[1:], heights(superpixels), strict=False)
        if z.mean() > 0.19
    ]
    assert sorted(map(sorted, sides)) == [[-1.0], [1.0]]


@pytest.mark.parametrize("label", [UNKNOWN, PASSABLE, NON_PASSABLE])
def test_only_steppable_pixels_take_part(seen_from_above, label):
    def labels(face):
        out = np.full(face.shape, STEPPABLE, dtype=np.uint8)
        out[face == 12] = label
        return out

    superpixels = oversegment(seen_from_above(boxes=BOXES, labels=labels), SETTINGS)
    assert (superpixels.state == REMOVED).sum() > 100
    assert all(abs(z.mean() - 0.08) > 0.01 for z in heights(superpixels))


def test_steep_and_unseen_pixels_take_no_part(seen_from_above):
    floor = seen_from_above()
    floor.normals[:64, :, 2] = 0.4
    floor.normals[70:74, 60:64] = np.nan
    superpixels = oversegment(floor, SETTINGS)
    assert (superpixels.assignment[:64] == -1).all()
    assert (superpixels.assignment[70:74, 60:64] == -1).all()
    assert (superpixels.state[70:74, 60:64] == REMOVED).all()
    assert (superpixels.state[0, 0] == EMPTY) and superpixels.assignment[0, 0] == -1


def test_each_pixel_goes_to_the_cluster_of_least_distance_by_equation_10(seen_from_above):
    superpixels = oversegment(seen_from_above(side=64, boxes=BOXES, noise=0.003), replace(SETTINGS, number=30))
    rng = np.random.default_rng(0)
    side, step, focal = 64, 64 / np.sqrt(30), superpixels.focal_length
    k = len(superpixels)
    clusters = np.column_stack([superpixels.points, superpixels.normals, np.zeros(k), superpixels.pixels])
    clusters = (clusters + rng.normal(0, 0.004, clusters.shape) * [1, 1, 1, 0, 0, 0, 0, 9, 9]).astype(np.float32)
    weights, limits = np.array([25, 100, 25, 3], np.float32), np.array([0.3, 0.03], np.float32)
    best, assignment = np.empty(side**2, np.float32), np.empty(side**2, np.int32)
    floor = kernels.Floor(superpixels.channels, side, focal)
    criteria = kernels.SuperpixelCriteria(weights, limits, step)
    kernels.assign(floor, clusters, k, int(step) + 1, criteria, best, assignment)
    ix, iy = np.divmod(np.arange(side**2), side)
    p, n = superpixels.channels[:3].T.astype(float), superpixels.channels[3:6].T.astype(float)
    total = np.full((k, side**2), np.inf)
    for c, (px, py, pz, nx, ny, nz, _, cx, cy) in enumerate(clusters.astype(float)):
        offset = p - [px, py, pz]
        d_n, d_p = 1 - n @ [nx, ny, nz], np.abs(offset @ [nx, ny, nz])
        d_w, d_c = np.linalg.norm(offset, axis=1), np.hypot(ix - cx, iy - cy)
        d = 25 * d_n / 0.3 + 100 * d_p / 0.03 + 25 * d_w / (step * -pz / focal) + 3 * d_c / step
        reach = int(step) + 1
        window = (np.abs(ix - int(cx)) <= reach) & (np.abs(iy - int(cy)) <= reach)
        total[c] = np.where(window & (d_n <= 0.3) & (d_p <= 0.03), d, np.inf)
    expected = np.where(np.isfinite(total.min(axis=0)), total.argmin(axis=0), -1)
    two = np.sort(total, axis=0)[:2]
    clear = ~(two[1] < two[0] + 1e-3)
    assert (expected >= 0).sum() > 1000
    np.testing.assert_array_equal(assignment[clear], expected[clear])
    np.testing.assert_allclose(best[expected >= 0], two[0][expected >= 0], rtol=1e-3)


def test_ransac_finds_the_plane_among_outliers():
    rng = np.random.default_rng(0)
    n = 400
    normal = np.array([0.2, -0.1, 1.0]) / np.linalg.norm([0.2, -0.1, 1.0])
    xy = rng.uniform(-0.1, 0.1, (n, 2))
    z = -0.8 - (xy @ normal[:2]) / normal[2] + rng.normal(0, 0.002, n)
    z[rng.random(n) < 0.3] += 0.04
    channels = np.zeros((7, 32 * 32), dtype=np.float32)
    channels[0, :n], channels[1, :n], channels[2, :n] = xy[:, 0], xy[:, 1], z
    clusters = np.array([[0, 0, -0.78, 0, 0, 1, 0, 5, 5]], dtype=np.float32)
    start, order, keep = np.array([0, n], np.int32), np.arange(n, dtype=np.int32), np.empty(1, bool)
    ransac = planes.Ransac(trials=10, sample=25, tolerance=0.01, least=12)
    planes.update(kernels.Floor(channels, 32, 20.0), start, order, 1, ransac, clusters, keep)
    assert keep[0]
    assert np.rad2deg(np.arccos(clusters[0, 3:6] @ normal)) < 0.8
    assert abs((clusters[0, :3] - [0, 0, -0.8]) @ normal) < 0.001


def test_equal_images_give_equal_superpixels(seen_from_above):
    floor = seen_from_above(boxes=BOXES, noise=0.003)
    one, two = oversegment(floor, SETTINGS), oversegment(floor, SETTINGS)
    np.testing.assert_array_equal(one.assignment, two.assignment)
    np.testing.assert_array_equal(one.normals, two.normals)


def test_an_empty_image_has_no_superpixels():
    can = Egocan(EgocanSettings(side=64))
    can.move(np.eye(4))
    assert len(oversegment(can.floor(), SETTINGS)) == 0


def test_unseen_ground_near_the_start_is_assumed_and_marked():
    can = Egocan(EgocanSettings(side=128))
    base = np.eye(4)
    base[:3, 3] = 1.0, 2.0, 0.5
    can.move(base)
    superpixels = oversegment(can.floor(), SETTINGS, ground=FloorGround((1.1, 2.0, 0.0), 0.3))
    assert len(superpixels) > 5
    assert superpixels.assumed.all()
    np.testing.assert_allclose(superpixels.points[:, 2], -0.5, atol=1e-6)
    points = superpixels.channels[:3, (superpixels.state == ASSUMED).ravel()]
    assert np.hypot(points[0] - 0.1, points[1]).max() < 0.3 + 1e-6
    # The assumption stays where the robot started.
    base[0, 3] = 1.4
    can.move(base)
    moved = oversegment(can.floor(), SETTINGS, ground=FloorGround((1.1, 2.0, 0.0), 0.3))
    points = moved.channels[:3, (moved.state == ASSUMED).ravel()]
    assert np.hypot(points[0] + 0.3, points[1]).max() < 0.3 + 1e-6


def test_assumed_ground_never_refills_what_was_seen(seen_from_above):
    def labels(face):
        return np.where(face == 0, NON_PASSABLE, STEPPABLE).astype(np.uint8)

    floor = seen_from_above(boxes=BOXES, labels=labels)
    superpixels = oversegment(floor, SETTINGS, ground=FloorGround((0.0, 0.0, 0.0), 2.0))
    seen = floor.known
    assert (superpixels.state[seen] != ASSUMED).all()
    for ix, iy in np.argwhere(superpixels.state == ASSUMED):
        assert not seen[max(0, ix - 4) : ix + 5, max(0, iy - 4) : iy + 5].any()
    assert all(np.ptp(z) < 1e-3 for z in heights(superpixels))


def test_assumed_and_seen_ground_never_share_a_superpixel(seen_from_above):
    floor = seen_from_above()
    floor.points[:60], floor.normals[:60] = np.nan, np.nan
    superpixels = oversegment(floor, SETTINGS, ground=FloorGround((0.0, 0.0, 0.0), 2.0))
    kinds = superpixels.channels[6]
    assert superpixels.assumed.any() and not superpixels.assumed.all()
    for c in range(len(superpixels)):
        members = superpixels.order[superpixels.start[c] : superpixels.start[c + 1]]
        assert (kinds[members] == superpixels.assumed[c]).all()


def drift(before, after, shift):
    """How far each superpixel that lives on moved in the world [m]."""
    where = {i: p for i, p in zip(before.ids, before.points, strict=True)}
    return np.array(
        [
            np.linalg.norm(p + np.append(shift, 0) - where[i])
            for i, p in zip(after.ids, after.points, strict=True)
            if i in where
        ]
    )


def nearest_drift(before, after, shift):
    """The same without identity: distance to the closest superpixel of before [m]."""
    return np.array([np.linalg.norm(p + np.append(shift, 0) - before.points, axis=1).min() for p in after.points])


def test_with_a_warm_start_superpixels_stay_put_while_the_robot_moves(seen_from_above):
    can = Egocan(EgocanSettings(side=128))
    before = oversegment(seen_from_above(boxes=BOXES, can=can), replace(SETTINGS, iterations=8))
    shift = (0.02, 0.013)
    floor = seen_from_above(boxes=BOXES, can=can, at=shift)
    warm, cold = oversegment(floor, SETTINGS, previous=before), oversegment(floor, SETTINGS)
    moved = drift(before, warm, shift)
    assert len(moved) > 0.9 * len(before)
    assert np.median(moved) < 0.25 * np.median(nearest_drift(before, cold, shift))
    assert np.median(moved) < 0.4 * 0.8 / floor.focal_length
    assert len(set(warm.ids)) == len(warm)
    assert max(np.ptp(z) for z in heights(warm)) < 1e-3


def test_ground_that_comes_into_view_gets_new_superpixels(seen_from_above):
    floor = seen_from_above()
    half = replace(floor, points=floor.points.copy())
    half.points[64:] = np.nan
    before = oversegment(half, SETTINGS)
    after = oversegment(floor, SETTINGS, previous=before)
    assert set(before.ids) <= set(after.ids)
    assert len(after) > 1.6 * len(before)
    assert (after.assignment[after.state == HEALTHY] >= 0).mean() > 0.97


@pytest.mark.parametrize(
    "setting",
    [{"number": 1}, {"iterations": 0}, {"normal_weight": -1.0}, {"upright": 1.0}, {"sample": 2}, {"tolerance": 0.0}],
)
def test_settings_out_of_range_are_refused(setting):
    with pytest.raises(PerceptionError, match=r"superpixels: .* expected"):
        SuperpixelSettings(**setting)


def test_the_cylinder_is_refused():
    can = Egocan()
    can.move(np.eye(4))
    with pytest.raises(PerceptionError, match="square floor image"):
        oversegment(can.cylinder())
