"""SciPy's rotations are the reference: intrinsic turns ZYX, quaternions x, y, z, w."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from legtool_runtime import rotations as rot

RNG = np.random.default_rng(0)
ANGLES = RNG.uniform([-3, -1.5, -3], [3, 1.5, 3], (40, 3))  # roll, pitch, yaw
TURNS = Rotation.from_euler("ZYX", ANGLES[:, ::-1])
QUATERNIONS = TURNS.as_quat()[:, [3, 0, 1, 2]]


def test_matrices_of_quaternions_lead_from_base_to_world():
    np.testing.assert_allclose(rot.rotation_of(QUATERNIONS), TURNS.as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(rot.rotation_of(QUATERNIONS[3]), rot.rotation_of(QUATERNIONS)[3])
    grid = rot.rotation_of(QUATERNIONS.reshape(4, 10, 4))
    np.testing.assert_array_equal(grid.reshape(-1, 3, 3), rot.rotation_of(QUATERNIONS))
    quarter = rot.rotation_of([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])  # about z: base x becomes world y
    np.testing.assert_allclose(quarter @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_quaternions_of_matrices_are_those_that_made_them():
    back = rot.quaternion_of(rot.rotation_of(QUATERNIONS))
    np.testing.assert_allclose(np.abs(np.sum(back * QUATERNIONS, axis=1)), 1, atol=1e-12)
    assert rot.quaternion_of(np.eye(3)).tolist() == [1, 0, 0, 0]


def test_roll_pitch_and_yaw_are_turns_about_the_moved_axes():
    for angles, turn, quaternion in zip(ANGLES, TURNS, QUATERNIONS, strict=True):
        np.testing.assert_allclose(rot.from_angles(*angles), turn.as_matrix(), atol=1e-14)
        same = rot.quaternion_from_angles(*angles)
        assert abs(same @ quaternion) == pytest.approx(1)
    assert (rot.from_angles(0, 0.2, 0) @ [1, 0, 0])[2] < 0  # a pitch above 0 is nose down


def test_a_turn_about_z_has_that_yaw_and_no_other_part():
    yaws = ANGLES[:, 2]
    np.testing.assert_allclose(rot.about_z(yaws), Rotation.from_euler("z", yaws[:, None]).as_matrix(), atol=1e-15)
    np.testing.assert_allclose(rot.yaw_of(rot.about_z(yaws)), yaws)
    np.testing.assert_allclose(rot.yaw_of(TURNS.as_matrix()), yaws)
    np.testing.assert_allclose(rot.rotation_of(rot.quaternion_about_z(yaws)), rot.about_z(yaws), atol=1e-15)
    assert rot.about_z(0.3).shape == (3, 3) and rot.quaternion_about_z(0.3).shape == (4,)


def test_points_of_a_base_are_turned_and_carried_along():
    points, origin = RNG.normal(size=(40, 3)), np.array([1.0, 2.0, 0.6])
    for angles, turn in zip(ANGLES, TURNS, strict=True):
        np.testing.assert_allclose(rot.place(points, *angles), turn.apply(points), atol=1e-14)
        np.testing.assert_allclose(rot.place(points[0], *angles, origin), origin + turn.apply(points[0]), atol=1e-14)


@pytest.mark.parametrize("shape", [(40, 3), (40, 4, 3)])
def test_rotating_there_and_back_is_the_identity(shape):
    vectors = RNG.normal(size=shape)
    world = rot.to_world(QUATERNIONS, vectors)
    expected = np.einsum("nij,n...j->n...i", TURNS.as_matrix(), vectors)
    np.testing.assert_allclose(world, expected, atol=1e-14)
    np.testing.assert_allclose(rot.to_base(QUATERNIONS, world), vectors, atol=1e-14)


def test_a_product_turns_by_the_second_first():
    both = rot.rotation_of(rot.multiply(QUATERNIONS[:20], QUATERNIONS[20:]))
    np.testing.assert_allclose(both, TURNS[:20].as_matrix() @ TURNS[20:].as_matrix(), atol=1e-14)
