import numpy as np
import pytest

from legtool.sim.worlds.convex import area, centroid, cut, hull, outside

SQUARE = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])


def test_a_hull_goes_counter_clockwise_and_leaves_out_what_is_inside() -> None:
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.permutation(SQUARE), rng.uniform(0.1, 0.9, (50, 2))])
    found = hull(points)
    assert area(found) == pytest.approx(1.0)
    assert {tuple(corner) for corner in found} == {tuple(corner) for corner in SQUARE}


def test_points_on_a_line_have_no_hull() -> None:
    assert hull(np.array([(0.0, 0.0), (1.0, 1.0), (2.0, 2.0), (0.5, 0.5)])).shape == (0, 2)


def test_a_cut_keeps_the_side_that_is_asked_for() -> None:
    left = cut(SQUARE, np.array([1.0, 0.0]), 0.25)
    assert area(left) == pytest.approx(0.25)
    np.testing.assert_allclose(centroid(left), [0.125, 0.5])
    assert len(cut(SQUARE, np.array([1.0, 0.0]), -0.1)) == 0
    np.testing.assert_array_equal(cut(SQUARE, np.array([1.0, 0.0]), 1.0), SQUARE)


def test_pieces_beside_a_hole_are_convex_disjoint_and_fill_what_is_left() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        hole = hull(rng.uniform(-0.2, 1.2, (6, 2)))
        pieces = outside(SQUARE, hole)
        covered = SQUARE
        for a, b in zip(hole, np.roll(hole, -1, axis=0), strict=True):
            outward = np.array([b[1] - a[1], a[0] - b[0]])
            covered = cut(covered, outward, float(outward @ a))
        assert sum(map(area, pieces)) + area(covered) == pytest.approx(1.0, abs=1e-6)
        for piece in pieces:
            assert area(hull(piece)) == pytest.approx(area(piece))


def test_a_polygon_beside_the_hole_stays_whole() -> None:
    for hole in (
        SQUARE + np.array([1.0, 0.0]),
        SQUARE + np.array([3.0, 0.0]),
        np.array([(1.9, 1.0), (1.9, 1.9), (1.0, 1.9)]),
    ):
        (piece,) = outside(SQUARE, hole)
        np.testing.assert_array_equal(piece, SQUARE)
    assert outside(SQUARE, 3.0 * SQUARE - 1.0) == []
