import numpy as np
import pytest

from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception.camera import as_metres, back_project
from legtool_runtime.perception.normals import normals


def angles(found, true):
    """Angle between unit vectors [deg], NaN where one is unknown."""
    return np.rad2deg(2 * np.arcsin(np.clip(np.linalg.norm(found - true, axis=-1) / 2, 0, 1)))


@pytest.mark.parametrize("reach", [0, 1, 3])
@pytest.mark.parametrize("pitch", [20, 45, 80])
def test_the_normal_of_a_plane_is_exact_at_any_pitch(world, pitch, reach):
    depth, true, face = world.render(world.camera, world.camera_pose([0, 0, 0.5], np.deg2rad(pitch)))
    error = angles(normals(as_metres(depth, world.camera), world.camera, reach=reach), true)[face == 0]
    known = error[np.isfinite(error)]
    assert known.size > 0.9 * (np.linalg.norm(back_project(depth, world.camera), axis=-1)[face == 0] < 3.0).sum()
    assert known.max() < 0.2


def test_the_normals_of_a_sphere_follow_its_surface(world):
    depth, true, _ = world.render(
        world.camera, world.camera_pose([0, 0, 0]), floor=None, spheres=[((1.0, 0.1, -0.1), 0.4)]
    )
    error = angles(normals(as_metres(depth, world.camera), world.camera), true)
    inside = (-true * back_project(as_metres(depth, world.camera), world.camera)).sum(axis=-1) > 0.3 * depth
    assert np.isfinite(error[inside]).mean() > 0.98
    assert np.nanmedian(error[inside]) < 1.0
    assert np.nanmax(error[inside]) < 8.0


def test_normals_have_unit_length_and_face_the_camera(world):
    camera = world.camera
    depth, _, _ = world.render(
        camera, world.camera_pose([0, 0, 0.6], 0.6), boxes=[((1.0, 0.1, 0.1), (0.2, 0.2, 0.1), 0.3)]
    )
    depth = as_metres(depth, camera)
    found, points = normals(depth, camera), back_project(depth, camera)
    known = np.isfinite(found[..., 0])
    np.testing.assert_allclose(np.linalg.norm(found[known], axis=-1), 1.0, atol=1e-5)
    assert ((found[known] * points[known]).sum(-1) < 0).all()


def test_a_normal_is_unknown_where_a_return_it_needs_is_missing(world):
    depth = np.full((120, 160), 1.0, dtype=np.float32)
    depth[50, 60] = 0.0
    unknown = np.isnan(normals(as_metres(depth, world.camera), world.camera)[..., 0])
    expected = np.zeros_like(unknown)
    expected[[50, 50, 49], [60, 59, 60]] = True
    expected[-1], expected[:, -1] = True, True
    np.testing.assert_array_equal(unknown, expected)


def test_a_jump_in_depth_has_no_normal(world):
    depth = np.full((120, 160), 1.0, dtype=np.float32)
    depth[:, 80:] = 2.0
    unknown = np.isnan(normals(as_metres(depth, world.camera), world.camera)[:-1, :-1, 0])
    assert unknown[:, 79].all()
    assert unknown.sum() == 119


def test_fitted_normals_withstand_noise_and_keep_edges_sharp(world):
    camera = world.camera
    boxes = [((1.0, 0.0, 0.15), (0.3, 0.3, 0.15), 0.3)]
    depth, true, face = world.render(camera, world.camera_pose([0, 0, 0.7], 0.6), boxes=boxes)
    near = (face >= 0) & (depth < 1.5)
    exact = angles(normals(as_metres(depth, camera), camera, reach=3), true)[near]
    assert (exact < 1.0).mean() > 0.97
    noisy = depth + np.random.default_rng(0).normal(0, 0.003, depth.shape).astype(np.float32)
    by_differences = np.nanmedian(angles(normals(as_metres(noisy, camera), camera), true)[near])
    fitted = angles(normals(as_metres(noisy, camera), camera, reach=3), true)[near]
    assert np.nanmedian(fitted) < 0.15 * by_differences
    assert np.nanmedian(fitted) < 3.0


def test_fitted_normals_reach_the_border_and_the_edge_of_a_void(world):
    depth = np.full((120, 160), 1.0, dtype=np.float32)
    depth[50:60, 60:70] = 0.0
    known = ~np.isnan(normals(as_metres(depth, world.camera), world.camera, reach=2)[..., 0])
    inside = depth > 0
    assert not known[~inside].any()
    assert known[inside].mean() > 0.995


def test_a_window_larger_than_the_image_is_refused(world):
    with pytest.raises(PerceptionError, match=r"reach 30 .* expected 0 to 29"):
        normals(np.ones((120, 160), dtype=np.float32), world.camera, reach=30)
