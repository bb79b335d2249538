from types import SimpleNamespace

import numpy as np
import pytest

from legtool_runtime import checks
from legtool_runtime.checks import Bounds
from legtool_runtime.errors import MapError, StateError
from legtool_runtime.rotations import from_angles


def test_arrays_come_back_as_fresh_plain_ones():
    given = np.arange(6, dtype=np.float32).reshape(2, 3).T
    array = checks.finite("state: feet", given, (3, 2), StateError)
    assert array.dtype == np.float64 and array.flags.c_contiguous
    array[:] = 0
    assert given.any()
    assert np.isnan(checks.numeric("state: feet", [np.nan], (1,), StateError)).all()


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("text", r"^state: feet is not an array of numbers"),
        ([[1, 2], [3]], r"^state: feet is not an array of numbers"),
        ([1, 2], r"^state: feet has shape \(2,\), expected \(3,\)$"),
        ([1, 2, np.nan], r"^state: feet holds a value that is not finite; look at it$"),
        ([1, 2, -np.inf], r"^state: feet holds a value that is not finite; look at it$"),
    ],
)
def test_arrays_that_cannot_be_used_are_named(value, said):
    with pytest.raises(StateError, match=said):
        checks.finite("state: feet", value, (3,), StateError, advice="; look at it")


def test_poses_are_rigid_to_what_single_precision_and_text_leave():
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = from_angles(0.3, -0.2, 2.0), [1, 2, 3]
    for same in (transform, transform.astype(np.float32), np.round(transform, 4).tolist()):
        np.testing.assert_allclose(checks.pose("pose", same, MapError), transform, atol=1e-4)


@pytest.mark.parametrize(
    ("transform", "said"),
    [
        (np.eye(3), r"^pose has shape \(3, 3\), expected \(4, 4\)"),
        (np.full((4, 4), np.nan), "^pose holds a value that is not finite"),
        (np.diag([1.01, 1.0, 1.0, 1.0]), "^pose is no rigid transform: expected a rotation"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "^pose is no rigid transform"),
        (np.diag([1.0, 1.0, 1.0, 2.0]), "0, 0, 0, 1 in the last row"),
    ],
)
def test_what_is_no_pose_is_refused(transform, said):
    with pytest.raises(MapError, match=said):
        checks.pose("pose", transform, MapError)


@pytest.mark.parametrize(
    ("bounds", "good", "bad", "said"),
    [
        (Bounds(0.1, 2.0), [0.1, 1, 2.0, np.float32(0.5)], [0, 2.1, np.nan, np.inf, "1", None, True], "0.1 to 2"),
        (Bounds(1, 20), [1, np.int64(20)], [0, 21, 2.0, True], "a whole number 1 to 20"),
        (Bounds(0.0, 0.1, "m", above=True), [1e-9, 0.1], [0.0, 0.2], "above 0, up to 0.1 m"),
        (Bounds(0.0, np.inf, "rad", above=True), [1e9], [0, -1, np.nan], "above 0 rad"),
        (Bounds(0.0, np.inf), [0, 5], [-1e-9], "at least 0"),
    ],
)
def test_settings_are_held_to_their_bounds(bounds, good, bad, said):
    for value in good:
        checks.within("gait", SimpleNamespace(length=value), {"length": bounds}, StateError)
    for value in bad:
        with pytest.raises(StateError) as caught:
            checks.within("gait", SimpleNamespace(length=value), {"length": bounds}, StateError)
        assert str(caught.value) == f"gait: length is {value!r}, expected {said}"
