"""The ray caster against MuJoCo's rays, pixel by pixel."""

import mujoco
import numpy as np
import pytest

from legtool.sim.worlds import raycast as rc
from legtool.sim.worlds.builder import Builder
from legtool.sim.worlds.mujoco_world import world_spec
from legtool.sim.worlds.surface import Surface
from legtool.sim.worlds.world import CUBOID
from legtool_runtime.perception.camera import Camera

CAMERA = Camera.from_field_of_view(160, 120, np.deg2rad(79))


def rotation(rng, tilt=True):
    if tilt:
        q, r = np.linalg.qr(rng.standard_normal((3, 3)))
        q *= np.sign(np.diag(r))
        return q * np.sign(np.linalg.det(q))
    yaw = rng.uniform(-np.pi, np.pi)
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def mujoco_cast(primitives, camera, pose, surface=None):
    """Depth, geom and world normal of each pixel by ``mj_multiRay``."""
    builder = Builder(surface, floor=False)
    for primitive in primitives:
        builder.add(CUBOID, primitive, 0.0)
    model = world_spec(builder.world).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], -1)
    world = rays.reshape(-1, 3) @ pose[:3, :3].T
    length = np.linalg.norm(world, axis=1)
    n = len(world)
    geom, distance, normal = np.empty(n, np.int32), np.empty(n), np.empty((n, 3))
    mujoco.mj_multiRay(
        model,
        data,
        pose[:3, 3],
        (world / length[:, None]).ravel(),
        None,
        True,
        -1,
        geom,
        distance,
        normal.ravel(),
        n,
        1e9,
    )
    depth = np.where(geom >= 0, distance / length, np.nan)
    return depth.reshape(u.shape), geom.reshape(u.shape), normal.reshape(*u.shape, 3)


def compare(primitives, pose, *, surface=None, tolerance=1e-5, odd=0.0):
    seen = rc.cast(rc.Scene.of(primitives, surface), CAMERA, pose)
    depth, geom, normal = mujoco_cast(primitives, CAMERA, pose, surface)
    differ = seen.geom != geom
    assert differ.mean() <= odd, f"{differ.sum()} pixels show another primitive"
    both = ~differ & (geom >= 0)
    assert np.isnan(seen.depth[seen.geom < 0]).all()
    error = np.abs(seen.depth - depth)[both]
    assert (error > tolerance * np.maximum(1, depth[both])).mean() <= odd, f"off by up to {error.max()} m"
    return seen, geom, normal, both


SOLIDS = {
    "box": lambda rng, p, r: rc.box(p, r, rng.uniform(0.05, 0.4, 3)),
    "cylinder": lambda rng, p, r: rc.cylinder(p, r, rng.uniform(0.05, 0.4), rng.uniform(0.05, 0.4)),
    "sphere": lambda rng, p, r: rc.sphere(p, rng.uniform(0.05, 0.4)),
    "capsule": lambda rng, p, r: rc.capsule(p, r, rng.uniform(0.05, 0.2), rng.uniform(0.05, 0.4)),
    "wedge": lambda rng, p, r: rc.wedge(p, r, rng.uniform(0.05, 0.4, 3)),
    "plane": lambda rng, p, r: rc.plane(p, r, *rng.uniform(0.2, 1.0, 2)),
}
ROUND_MESHES = {
    "semisphere": lambda rng, p, r: rc.semisphere(p, r, rng.uniform(0.1, 0.4)),
    "tube": lambda rng, p, r: rc.tube(p, r, *(rng.uniform(0.15, 0.3) * np.array([1.0, 0.8])), rng.uniform(0.1, 0.4)),
}


def scatter(rng, make, n, tilt=True):
    return [make(rng, [rng.uniform(0.9, 3), *rng.uniform(-1, 1, 2)], rotation(rng, tilt)) for _ in range(n)]


@pytest.mark.parametrize("name", SOLIDS)
def test_depth_and_normals_of_a_solid_are_those_of_mujoco(name):
    for seed in range(6):
        rng = np.random.default_rng([seed, len(name)])
        pose = rc.camera_pose(rng.uniform(-0.1, 0.1, 3), roll=rng.normal() * 0.3, pitch=0.2, yaw=rng.normal() * 0.2)
        seen, _, normal, both = compare(scatter(rng, SOLIDS[name], 8), pose)
        assert both.mean() > 0.05
        cosine = np.abs(np.sum(seen.normal * normal, -1)[both])
        assert (cosine < 1 - 1e-4).mean() < 1e-3  # at an edge either face may be named
        assert np.allclose(np.linalg.norm(seen.normal[both], axis=-1), 1, atol=1e-5)


@pytest.mark.parametrize("name", ROUND_MESHES)
def test_a_round_shape_is_that_of_a_fine_mesh(name):
    for seed in range(3):
        rng = np.random.default_rng([seed, 7])
        pose = rc.camera_pose([0, 0, 0.1], pitch=0.1)
        seen, _, normal, both = compare(scatter(rng, ROUND_MESHES[name], 4), pose, tolerance=2e-3, odd=0.004)
        cosine = np.sum(seen.normal * normal, -1)[both]
        assert np.percentile(np.abs(cosine), 2) > 0.999


def test_a_semisphere_on_the_ground_is_a_sphere_sunk_into_it():
    ground, pose = rc.plane([0, 0, 0], np.eye(3)), rc.camera_pose([0, 0, 0.5], pitch=0.4)
    dome = rc.cast(rc.Scene.of([ground, rc.semisphere([1.2, 0.1, 0], np.eye(3), 0.2)]), CAMERA, pose)
    depth, geom, _ = mujoco_cast([ground, rc.sphere([1.2, 0.1, 0], 0.2)], CAMERA, pose)
    assert (dome.geom != geom).sum() == 0
    assert np.nanmax(np.abs(dome.depth - depth)) < 1e-5


def test_a_height_surface_is_mujocos_height_field():
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.arange(101), np.arange(81), indexing="ij")
    heights = 0.06 * np.sin(x / 7) * np.cos(y / 9) + 0.01 * rng.standard_normal(x.shape)
    surface = Surface(heights, 0.04, np.array([-0.5, -1.6]))
    pose = rc.camera_pose([0.0, 0.1, 0.5], pitch=0.5, roll=0.05, yaw=0.1)
    seen, _, normal, both = compare([rc.box([1.5, 0, 0.2], np.eye(3), [0.2, 0.3, 0.25])], pose, surface=surface)
    assert (np.abs(np.sum(seen.normal * normal, -1))[both] < 1 - 1e-4).mean() < 1e-3
    top = seen.geom == 1
    v, u = np.nonzero(top)
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(len(u))], -1)
    points = pose[:3, 3] + seen.depth[top][:, None] * rays @ pose[:3, :3].T
    assert np.abs(surface.height(points[:, 0], points[:, 1]) - points[:, 2]).max() < 1e-5


def test_a_full_room_is_seen_as_mujoco_sees_it():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        walls = [
            rc.plane([4, 0, 1], [[0, 0, -1], [0, 1, 0], [1, 0, 0]], 1, 4),
            rc.plane([0, 4, 1], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], 4, 1),
            rc.plane([0, 0, 2], np.diag([1.0, -1, -1])),
        ]
        things = [make for make in SOLIDS.values() for _ in range(3)]
        scene = [rc.plane([0, 0, 0], np.eye(3)), *walls]
        scene += [
            make(rng, [*rng.uniform([0.8, -1.5], [3, 1.5]), rng.uniform(0, 0.3)], rotation(rng)) for make in things
        ]
        compare(scene, rc.camera_pose([0, 0, 0.6], pitch=0.4, roll=0.05))


def test_a_primitive_that_reaches_behind_the_camera_is_seen_whole():
    beam = rc.box([0, 0.3137, 0.0071], np.eye(3), [5, 0.05, 0.05])
    seen, *_ = compare(
        [beam, rc.cylinder([0, -0.2913, 0.0039], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], 0.05, 4)],
        rc.camera_pose([0, 0, 0.2]),
    )
    assert (seen.geom == 0).any() and (seen.geom == 1).any()


def test_nothing_is_returned_beyond_the_far_limit_or_in_an_empty_world():
    ground = rc.Scene.of([rc.plane([0, 0, 0], np.eye(3))])
    seen = rc.cast(ground, CAMERA, rc.camera_pose([0, 0, 0.5], pitch=0.3), far=2.0)
    assert np.nanmax(seen.depth) <= 2.0 and np.isnan(seen.depth[0]).all()
    empty = rc.cast(rc.Scene.of([]), CAMERA, rc.camera_pose([0, 0, 1]))
    assert np.isnan(empty.depth).all() and (empty.geom == -1).all() and not empty.normal.any()


def test_a_tubes_inside_is_seen_through_its_end_and_daylight_through_both():
    along_x = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    scene = rc.Scene.of([rc.tube([1.0, 0, 0], along_x, 0.2, 0.18, 0.5)])
    straight = rc.cast(scene, CAMERA, rc.camera_pose([0, 0, 0]))
    middle = (CAMERA.height // 2, CAMERA.width // 2)
    assert straight.geom[middle] == -1
    inside = (straight.geom == 0) & (straight.depth > 0.55)
    assert inside.any()
    v, u = np.nonzero(inside)
    towards_axis = np.stack([np.zeros(len(u)), u - CAMERA.cx, v - CAMERA.cy], -1)
    assert (np.sum(straight.normal[inside] * towards_axis, -1) > 0).all()


def test_a_far_limit_in_whole_metres_leaves_depths_as_they_are():
    ground = rc.Scene.of([rc.plane([0, 0, 0], np.eye(3))])
    pose = rc.camera_pose([0, 0, 0.5], pitch=0.3)
    np.testing.assert_array_equal(
        rc.cast(ground, CAMERA, pose, far=2).depth, rc.cast(ground, CAMERA, pose, far=2.0).depth
    )
