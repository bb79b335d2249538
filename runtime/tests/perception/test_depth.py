import numpy as np
import pytest

from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception.camera import Camera
from legtool_runtime.perception.depth import (
    PREPARATION,
    STEPS,
    decimate,
    fill_holes,
    fit_camera,
    prepare,
    prepared_camera,
)

NAN = np.nan


def blocks(*rows):
    return np.array(rows, dtype=np.float32).reshape(-1, 2, 2).transpose(1, 0, 2).reshape(2, -1)


def test_decimation_takes_the_median_of_the_returns_and_invents_no_depth():
    depth = blocks([1, 2, 3, 4], [1, NAN, 5, 3], [NAN, 7, NAN, 6], [NAN, NAN, NAN, 2], [NAN] * 4)
    np.testing.assert_array_equal(decimate(depth)[0], np.array([2, 3, 6, 2, NAN], dtype=np.float32))
    rng = np.random.default_rng(0)
    depth = np.where(rng.uniform(size=(60, 80)) < 0.3, NAN, rng.uniform(1, 5, (60, 80))).astype(np.float32)
    small = decimate(depth)
    for v in range(30):
        for u in range(40):
            block = depth[2 * v : 2 * v + 2, 2 * u : 2 * u + 2]
            returns = np.sort(block[~np.isnan(block)])
            expected = returns[(len(returns) - 1) // 2] if len(returns) else NAN
            np.testing.assert_equal(small[v, u], np.float32(expected))


def test_an_odd_row_and_column_are_left_out():
    assert decimate(np.ones((5, 7), dtype=np.float32)).shape == (2, 3)


def test_a_small_hole_takes_the_farthest_depth_around_it():
    depth = np.full((20, 30), 2.0, dtype=np.float32)
    depth[:, 15:] = 3.0
    depth[8:11, 13:17] = NAN
    filled = fill_holes(depth)
    assert not np.isnan(filled).any()
    assert set(np.unique(filled)) == {2.0, 3.0}
    assert filled[9, 15] == 3.0
    assert np.isnan(depth[9, 14])  # the image given is left as it was


def test_the_sky_and_a_large_hole_stay_unknown():
    depth = np.full((60, 80), 2.0, dtype=np.float32)
    depth[:20] = NAN
    depth[30:55, 20:50] = NAN
    filled = fill_holes(depth)
    assert np.isnan(filled[:20]).all()
    assert np.isnan(filled[36:48, 26:44]).all()
    known = ~np.isnan(depth)
    np.testing.assert_array_equal(filled[known], depth[known])


def test_preparing_is_the_list_of_named_steps():
    rng = np.random.default_rng(1)
    depth = np.where(rng.uniform(size=(48, 64)) < 0.2, NAN, 2.0).astype(np.float32)
    expected = fill_holes(decimate(depth))
    np.testing.assert_array_equal(prepare(depth), expected)
    np.testing.assert_array_equal(prepare(depth, ()), depth)
    assert set(PREPARATION) <= set(STEPS)
    with pytest.raises(PerceptionError, match=r"sharpen.*decimate, fill_holes"):
        prepare(depth, ("sharpen",))


def test_the_prepared_cameras_rays_are_the_middles_of_the_blocks():
    camera = Camera.from_field_of_view(640, 480, 1.4)
    small = prepared_camera(camera)
    assert (small.width, small.height) == (320, 240)
    for u in (0, 100, 319):
        middle = (2 * u + 0.5 - camera.cx) / camera.fx
        assert (u - small.cx) / small.fx == pytest.approx(middle)
    assert small.fields_of_view == pytest.approx(camera.fields_of_view)


def test_an_image_of_another_camera_shows_the_same_rays():
    wide, narrow = Camera.from_field_of_view(320, 240, 1.4), Camera(200, 150, 300.0, 310.0, 90.0, 80.0)

    def plane(camera):
        a = (np.arange(camera.width) - camera.cx) / camera.fx
        b = (np.arange(camera.height) - camera.cy) / camera.fy
        return (1 / (0.5 + 0.2 * a + 0.3 * b[:, None])).astype(np.float32)

    seen = fit_camera(plane(narrow), narrow, wide)
    known = ~np.isnan(seen)
    np.testing.assert_allclose(seen[known], plane(wide)[known], rtol=3e-3)
    assert 0.05 < known.mean() < 0.6 and np.isnan(seen[0]).all() and np.isnan(seen[:, 0]).all()
    np.testing.assert_array_equal(fit_camera(plane(wide), wide, wide), plane(wide))
