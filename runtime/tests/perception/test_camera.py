import numpy as np
import pytest

from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception.camera import Camera, as_metres, back_project

CAMERA = Camera(64, 48, 50.0, 52.0, 31.0, 24.5)


def test_back_projected_points_project_onto_their_own_pixels():
    depth = np.random.default_rng(0).uniform(0.3, 4.0, (48, 64)).astype(np.float32)
    points = back_project(depth, CAMERA)
    v, u = np.meshgrid(np.arange(48), np.arange(64), indexing="ij")
    np.testing.assert_allclose(points[..., 0] / points[..., 2] * 50.0 + 31.0, u, atol=1e-4)
    np.testing.assert_allclose(points[..., 1] / points[..., 2] * 52.0 + 24.5, v, atol=1e-4)
    np.testing.assert_array_equal(points[..., 2], depth)


def test_a_camera_from_its_field_of_view_sees_that_field_of_view():
    camera = Camera.from_field_of_view(640, 480, np.deg2rad(70))
    assert np.rad2deg(camera.fields_of_view[0]) == pytest.approx(70.0)


def test_sensor_millimetres_and_metres_give_the_same_depth():
    millimetres = np.full((48, 64), 1500, dtype=np.uint16)
    millimetres[0, 0] = 0
    metres = np.full((48, 64), 1.5)
    metres[0, 0] = np.nan
    np.testing.assert_array_equal(as_metres(millimetres, CAMERA), as_metres(metres, CAMERA))


@pytest.mark.parametrize("nothing", [0.0, np.nan, np.inf])
def test_pixels_without_return_become_nan(nothing):
    depth = np.ones((48, 64), dtype=np.float32)
    depth[5, 6] = nothing
    metres = as_metres(depth, CAMERA)
    assert np.isnan(metres[5, 6])
    assert np.isnan(metres).sum() == 1


@pytest.mark.parametrize("nothing", [0.0, np.nan, np.inf])
def test_a_depth_image_without_any_return_is_refused(nothing):
    with pytest.raises(PerceptionError, match="none of its 3072 pixels holds a return"):
        as_metres(np.full((48, 64), nothing), CAMERA)


def test_a_single_return_between_the_sampled_pixels_is_found():
    depth = np.zeros((48, 64), dtype=np.float32)
    depth[5, 6] = 1.0
    assert as_metres(depth, CAMERA)[5, 6] == 1.0


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.ones((48, 64), dtype=np.uint8), "type uint8"),
        (np.ones((48, 64), dtype=np.int32), "type int32"),
        (np.ones((64, 48)), r"shape \(64, 48\), expected \(48, 64\)"),
        (np.ones((48, 64, 1)), "shape"),
        (np.full((48, 64), 1500.0), "millimetres; divide by 1000"),
        (np.full((48, 64), 2, dtype=np.uint16), "not to be millimetres"),
        (np.full((48, 64), -1.0), "3072 pixels are negative"),
    ],
)
def test_a_depth_image_of_another_kind_is_refused_by_name(image, message):
    with pytest.raises(PerceptionError, match=message):
        as_metres(image, CAMERA)


@pytest.mark.parametrize(
    ("intrinsics", "message"),
    [
        ((320, 240, 600.0, 600.0, 320.0, 240.0), "outside a 320 × 240 image"),
        ((64, 48, 9000.0, 9000.0, 31.5, 23.5), "sees 0.4°"),
        ((640, 480, 20.0, 20.0, 319.5, 239.5), "expected 5° to 160°"),
        ((64, 48, 50.0, 110.0, 31.5, 23.5), "differ by more"),
        ((64, 48, -50.0, 50.0, 31.5, 23.5), "above 0"),
        ((64, 48, np.nan, 50.0, 31.5, 23.5), "fx is nan, expected above 0"),
        ((1, 48, 50.0, 50.0, 0.0, 23.5), "width is 1, expected a whole number 2"),
    ],
)
def test_intrinsics_that_do_not_fit_the_image_are_refused(intrinsics, message):
    with pytest.raises(PerceptionError, match=message):
        Camera(*intrinsics)
