import numpy as np
import pytest

from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception import NON_PASSABLE, STEPPABLE, UNKNOWN
from legtool_runtime.perception.camera import as_metres
from legtool_runtime.perception.egocan import Egocan, EgocanSettings
from legtool_runtime.perception.normals import normals

MOUNT = np.array([0.3, 0.0, 0.1])
HEIGHT = 0.4
BOX = ((0.9, 0.1, 0.05), (0.15, 0.15, 0.05), 0.3)


def base_pose(x=0.0, y=0.0, *, roll=0.0, pitch=0.0, yaw=0.0, z=HEIGHT):
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    pose = np.eye(4)
    pose[:3, :3] = (
        np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
        @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    )
    pose[:3, 3] = x, y, z
    return pose


def look(can, world, base, *, labels=None, pitch=0.7, **scene):
    """Move the can to ``base`` and insert what a camera on the robot sees; returns that frame."""
    camera_to_world = base @ world.camera_pose(MOUNT, pitch)
    depth, _, face = world.render(world.camera, camera_to_world, **scene)
    depth = as_metres(depth, world.camera)
    found = normals(depth, world.camera)
    can.move(base)
    can.insert(depth, found, camera=world.camera, transform_camera_to_world=camera_to_world, labels=labels)
    return depth, camera_to_world, face


def in_world(image):
    points = image.points[image.known].astype(float)
    pose = image.transform_to_world
    return points @ pose[:3, :3].T + pose[:3, 3]


def put(can, points):
    """Insert single points of the levelled frame, through a camera at the can's origin that looks along each."""
    from legtool_runtime.perception import egocan_kernels as kernels

    points = np.asarray(points, dtype=np.float32).T.copy()
    cell, distance = np.empty(points.shape[1], np.int32), np.empty(points.shape[1], np.float32)
    kernels.project(points, points.shape[1], can._shape, can._scale, cell, distance)
    return cell, distance


def test_points_fall_into_the_cells_of_equations_1_2_and_4():
    can = Egocan()
    points = np.random.default_rng(0).normal(size=(5000, 3))
    cell, distance = put(can, points)
    x_cam, y_cam, z_cam = -points[:, 1], -points[:, 2], points[:, 0]  # the paper's frame: x right, y down, z ahead
    rho = np.hypot(x_cam, z_cam)
    u = np.arctan2(x_cam, z_cam) * 512 / (2 * np.pi) + 256
    v = y_cam / rho * 64 / np.tan(np.pi / 6) + 64
    focal = 128 * np.tan(np.pi / 6)
    u_low, v_low = focal * x_cam / np.abs(y_cam) + 128, focal * z_cam / np.abs(y_cam) + 128
    cylinder = np.abs(y_cam) < rho * np.tan(np.pi / 6)
    ix, iy = np.floor(v_low), np.floor(256 - u_low)  # our caps: x ahead, y to the left
    expected = np.where(
        cylinder, np.floor(v) * 512 + np.floor(u), 512 * 128 + np.where(y_cam > 0, 0, 256**2) + ix * 256 + iy
    )
    edge = [np.abs(a - np.round(a)) < 2e-3 for a in (u, v, u_low, v_low)]
    clear = ~(edge[0] | edge[1] | edge[2] | edge[3])
    assert clear.sum() > 4000
    np.testing.assert_array_equal(cell[clear], expected[clear])
    np.testing.assert_allclose(distance, np.where(cylinder, rho, np.abs(y_cam)), rtol=1e-5)


def test_with_the_papers_focal_length_cylinder_rows_follow_equation_2():
    can = Egocan(EgocanSettings(vertical_field_of_view=2 * np.arctan(np.pi * 128 / 512)))
    assert can._scale[1] == pytest.approx(1 / np.tan(2 * np.pi / 512), rel=1e-3)


def test_every_direction_belongs_to_a_cell():
    can = Egocan(EgocanSettings(width=64, height=16, side=32))
    directions = np.random.default_rng(1).normal(size=(20000, 3))
    cell, distance = put(can, np.vstack([directions, np.eye(3), -np.eye(3), [[-1, 1e-9, 0], [-1, -1e-9, 0]]]))
    assert cell.min() >= 0
    assert cell.max() < 64 * 16 + 2 * 32**2
    assert np.isfinite(distance).all()


def test_the_floor_image_holds_exact_points_of_the_floor_and_the_box(world):
    can = Egocan(EgocanSettings(lift=0.3))
    look(can, world, base_pose(), boxes=[BOX])
    points = in_world(can.floor())
    assert len(points) > 2000
    on_floor, on_top = np.abs(points[:, 2]) < 1e-5, np.abs(points[:, 2] - 0.1) < 1e-5
    between = (points[:, 2] > 0) & (points[:, 2] < 0.1)
    assert (on_floor | on_top | between).all()
    assert on_top.sum() > 200


def test_the_levelled_frame_stays_level_when_the_base_rolls_and_pitches(world):
    can = Egocan(EgocanSettings(lift=0.3))
    look(can, world, base_pose(roll=0.2, pitch=-0.25, yaw=0.4))
    floor = can.floor()
    up = floor.normals[floor.known & np.isfinite(floor.normals[..., 0])]
    assert np.abs(in_world(floor)[:, 2]).max() < 1e-5
    assert up[:, 2].min() > 0.9999
    assert floor.transform_to_world[2, :3] == pytest.approx([0, 0, 1])


def test_a_surface_seen_at_a_grazing_angle_has_no_normal(world):
    # There a floor cannot be told from what noise smears over a jump in depth.
    can = Egocan()
    _, camera_to_world, _ = look(can, world, base_pose(), pitch=0.3)
    cylinder = can.cylinder()
    points = in_world(cylinder)
    assert np.abs(points[:, 2]).max() < 1e-4
    rays = points - camera_to_world[:3, 3]
    incidence = np.rad2deg(np.arccos(-rays[:, 2] / np.linalg.norm(rays, axis=1)))
    known = np.isfinite(cylinder.normals[cylinder.known][:, 2])
    assert known[incidence < 74].mean() > 0.95
    assert (incidence > 76).sum() > 500
    assert not known[incidence > 76].any()


def test_the_nearest_return_wins_a_cell(world):
    can = Egocan()
    depth = np.full((120, 160), 2.0, dtype=np.float32)
    depth[60:64, 80:84] = 0.5  # several pixels share a cell with farther ones
    can.move(base_pose())
    pose = base_pose() @ world.camera_pose([0, 0, 0])
    can.insert(depth, normals(depth, world.camera), camera=world.camera, transform_camera_to_world=pose)
    ranges = np.linalg.norm(can.cylinder().points[..., :2], axis=-1)
    near = ranges < 1
    assert near.sum() >= 4
    # No far point remains where the near patch projects.
    v, u = np.nonzero(near)
    inside = ranges[v.min() : v.max() + 1, u.min() : u.max() + 1]
    assert np.nanmax(inside) < 1


@pytest.mark.parametrize("steps", [10, 1500])
def test_points_stay_exact_at_any_rate_of_propagation(world, steps):
    can = Egocan(EgocanSettings(lift=0.3))
    look(can, world, base_pose(), boxes=[BOX])
    for k in range(1, steps + 1):
        can.move(base_pose(0.15 * k / steps, yaw=0.3 * k / steps))
    points = in_world(can.floor())
    top = points[points[:, 2] > 0.0998]
    c, s = np.cos(BOX[2]), np.sin(BOX[2])
    local = (top[:, :2] - BOX[0][:2]) @ np.array([[c, -s], [s, c]])
    assert len(top) > 200
    assert np.abs(local).max() < 0.15 + 1e-3
    assert np.abs(local).max(axis=0) == pytest.approx([0.15, 0.15], abs=0.01)
    assert np.median(np.abs(top[:, 2] - 0.1)) < 2e-5
    assert points[:, 2].min() > -1e-4
    assert points[:, 2].max() < 0.1 + 1e-4


def test_what_passed_under_the_feet_is_remembered_and_not_thinned_out(world):
    can = Egocan(EgocanSettings(side=128, lift=0.3))
    boxes = [((0.9, 0.0, 0.05), (0.12, 0.12, 0.05), 0.0)]
    for k in range(121):
        look(can, world, base_pose(0.01 * k), boxes=boxes)
    floor = can.floor()
    points = in_world(floor)
    box = np.abs(points - [0.9, 0.0, 0.1]).max(axis=1)
    behind = (np.abs(points[:, :2] - [0.9, 0.0]).max(axis=1) < 0.12) & (points[:, 2] > 0.09)
    assert box[behind].max() <= 0.1201
    cell = (0.7 - 0.1) / floor.focal_length
    assert behind.sum() > 0.6 * (0.24 / cell) ** 2


def test_an_obstacle_that_went_away_is_forgotten_when_the_camera_sees_through_it(world):
    can = Egocan(EgocanSettings(lift=0.3))
    look(can, world, base_pose(), boxes=[BOX])
    assert (in_world(can.floor())[:, 2] > 0.05).any()
    look(can, world, base_pose())
    assert in_world(can.floor())[:, 2].max() < 0.04  # nearer to the floor it is the same surface
    assert np.nanmax(can.cylinder().points[..., 2]) < 0.04 - HEIGHT - 0.3


def test_what_is_hidden_from_the_camera_is_kept(world):
    can = Egocan(EgocanSettings(lift=0.3))
    look(can, world, base_pose(), boxes=[BOX])
    wall = ((0.55, 0.0, 0.05), (0.01, 2.0, 0.25), 0.0)
    look(can, world, base_pose(), boxes=[BOX, wall])
    points = in_world(can.floor())
    assert ((points[:, 0] > 0.8) & (np.abs(points[:, 2] - 0.1) < 1e-4)).sum() > 100


def test_labels_are_unknown_until_they_come_and_are_then_carried_along(world):
    can = Egocan(EgocanSettings(lift=0.3))
    depth, pose, face = look(can, world, base_pose(), boxes=[BOX])
    floor = can.floor()
    assert (floor.labels[floor.known] == UNKNOWN).all()
    look(can, world, base_pose(0.02), boxes=[BOX])  # the robot walks on while the network thinks
    look(can, world, base_pose(0.04), boxes=[BOX])
    labels = np.where(face == 12, STEPPABLE, np.where(face == -1, UNKNOWN, NON_PASSABLE)).astype(np.uint8)
    can.relabel(labels, depth, camera=world.camera, transform_camera_to_world=pose)
    for k in range(3, 6):
        look(can, world, base_pose(0.02 * k), boxes=[BOX])  # frames that have no labels yet
    floor = can.floor()
    height = in_world(floor)[:, 2]
    label = floor.labels[floor.known]
    assert (label[height > 0.099] == STEPPABLE).mean() > 0.85
    assert (label[height < 0.001] == STEPPABLE).mean() < 0.01
    assert (label[height < 0.001] == NON_PASSABLE).mean() > 0.6


def test_a_new_surface_does_not_take_over_the_old_ones_label(world):
    can = Egocan(EgocanSettings(lift=0.3))
    labels = np.full((120, 160), STEPPABLE, dtype=np.uint8)
    look(can, world, base_pose(), labels=labels)
    look(can, world, base_pose(), boxes=[((0.9, 0.1, 0.1), (0.15, 0.15, 0.1), 0.0)])
    floor = can.floor()
    assert (floor.labels[floor.known][in_world(floor)[:, 2] > 0.199] == UNKNOWN).all()


def test_a_jump_of_the_pose_is_refused_and_changes_nothing(world):
    can = Egocan()
    look(can, world, base_pose())
    before = can.floor()
    with pytest.raises(PerceptionError, match=r"jumped by 3\.00 m .* call reset"):
        can.move(base_pose(3.0))
    with pytest.raises(PerceptionError, match=r"and 115°"):
        can.move(base_pose(yaw=2.0))
    np.testing.assert_array_equal(can.floor().points, before.points)
    can.reset()
    can.move(base_pose(3.0))
    assert not can.floor().known.any()


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.eye(3), r"shape \(3, 3\)"),
        (np.full((4, 4), np.nan), "not finite"),
        (2 * np.eye(4), "expected a rotation"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "expected a rotation"),
    ],
)
def test_what_is_no_pose_is_refused(pose, message):
    with pytest.raises(PerceptionError, match=message):
        Egocan().move(pose)


def test_images_that_do_not_belong_together_are_refused(world):
    can, camera = Egocan(), world.camera
    depth = np.ones((120, 160), dtype=np.float32)
    ups = np.zeros((120, 160, 3), dtype=np.float32)
    pose = np.eye(4)
    with pytest.raises(PerceptionError, match="no pose yet"):
        can.insert(depth, ups, camera=camera, transform_camera_to_world=pose)
    can.move(pose)
    with pytest.raises(PerceptionError, match=r"take it through camera\.as_metres"):
        can.insert(depth.astype(float), ups, camera=camera, transform_camera_to_world=pose)
    with pytest.raises(PerceptionError, match="normals"):
        can.insert(depth, ups[1:], camera=camera, transform_camera_to_world=pose)
    with pytest.raises(PerceptionError, match=r"label image: uint8 \(60, 80\)"):
        can.insert(depth, ups, camera=camera, transform_camera_to_world=pose, labels=np.zeros((60, 80), dtype=np.uint8))
    with pytest.raises(PerceptionError, match="value 7, expected 0 to 3"):
        can.relabel(np.full((120, 160), 7, dtype=np.uint8), depth, camera=camera, transform_camera_to_world=pose)


@pytest.mark.parametrize(
    "setting", [{"width": 4}, {"side": 5000}, {"vertical_field_of_view": 3.0}, {"lift": -1.0}, {"largest_rotation": 0}]
)
def test_settings_out_of_range_are_refused(setting):
    with pytest.raises(PerceptionError, match="egocan"):
        EgocanSettings(**setting)
