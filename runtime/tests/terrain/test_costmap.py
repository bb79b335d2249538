import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from legtool_runtime.errors import MapError
from legtool_runtime.terrain.costmap import costmap_from_mask, foot_cost, foot_costmap
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.terrain.settings import CostmapSettings

R = 0.02


def heights_of(profile):
    """A map that is the same along y."""
    return np.repeat(np.asarray(profile, np.float32)[:, None], 40, axis=1)


@given(seed=st.integers(0, 2**32 - 1), nx=st.integers(3, 40), ny=st.integers(3, 40), share=st.floats(0.0, 1.0))
@settings(max_examples=200, deadline=None)
def test_distance_is_that_of_scipy_on_any_mask(seed, nx, ny, share):
    unsafe = np.random.default_rng(seed).random((nx, ny)) < share
    padded = np.pad(unsafe, 1, constant_values=True)
    found = costmap_from_mask(unsafe, R, center=(0, 0)).distance
    np.testing.assert_allclose(found, R * distance_transform_edt(~padded)[1:-1, 1:-1], rtol=1e-6)
    open_map = costmap_from_mask(unsafe, R, center=(0, 0), unknown_unsafe=False).distance
    if unsafe.any():
        np.testing.assert_allclose(open_map, R * distance_transform_edt(~unsafe), rtol=1e-6)
    else:
        assert np.isinf(open_map).all()


@given(seed=st.integers(0, 2**32 - 1), reach=st.integers(1, 4), step=st.integers(1, 5))
@settings(max_examples=40, deadline=None)
def test_unsafe_cells_are_those_a_plain_loop_over_windows_finds(seed, reach, step):
    rng = np.random.default_rng(seed)
    heights = np.where(rng.random((17, 23)) < 0.2, 0.05, 0.0) + rng.normal(0, 0.004, (17, 23))
    heights[rng.random((17, 23)) < 0.2] = np.nan
    s = CostmapSettings(
        window_m=2 * reach * R, step_window_m=2 * step * R, drop_threshold_m=0.056, drop_window_m=4 * reach * R
    )
    expected = np.zeros(heights.shape, bool)
    unknown = np.pad(np.isnan(heights), 1)
    together = np.zeros(heights.shape, bool)
    for i, j in np.ndindex(*heights.shape):
        inside = 0 < i < heights.shape[0] - 1
        together[i, j] = inside and unknown[i + 1, j + 1] and unknown[i : i + 3, j : j + 3].sum() >= 5
    for i, j in np.ndindex(*heights.shape):
        near, around, far = (
            heights[max(i - k, 0) : i + k + 1, max(j - k, 0) : j + k + 1] for k in (reach, step, 2 * reach)
        )
        h = np.float32(heights[i, j])
        if np.isnan(h):
            expected[i, j] = True
        else:
            near, far = near[~np.isnan(near)].astype(np.float32), far[~np.isnan(far)].astype(np.float32)
            expected[i, j] = near.max() - near.min() > s.height_threshold_m or far.max() - h > s.drop_threshold_m
            lower = h - np.nanmin(around).astype(np.float32)
            expected[i, j] |= s.height_threshold_m < lower < s.drop_threshold_m
            hidden = together[max(i - reach, 0) : i + reach + 1, max(j - reach, 0) : j + reach + 1]
            expected[i, j] |= hidden.any()
    np.testing.assert_array_equal(foot_costmap(HeightMap(heights, R, (0, 0)), s).unsafe, expected)


def test_both_sides_of_a_step_are_unsafe_the_upper_one_farther_and_flat_ground_is_not():
    profile = np.where(np.arange(60) < 30, 0.0, 0.06)
    costmap = foot_costmap(HeightMap(heights_of(profile), R, (0, 0)), CostmapSettings(step_window_m=0.12))
    unsafe = costmap.unsafe[:, 20]
    assert unsafe[29:33].all()
    assert not unsafe[5:29].any() and not unsafe[33:55].any()


def test_the_flat_floor_of_a_gap_is_unsafe_throughout():
    x = np.arange(100) * R
    profile = np.where((x > 0.8) & (x < 1.0), -0.4, 0.0)
    unsafe = foot_costmap(HeightMap(heights_of(profile), R, (0, 0))).unsafe[:, 20]
    assert unsafe[profile < 0].all()
    assert not unsafe[2:37].any() and not unsafe[53:98].any()


def test_an_edge_that_hides_what_is_behind_it_is_kept_away_from_like_one_that_is_seen():
    profile = np.where(np.arange(60) < 30, 0.06, 0.0)
    seen = foot_costmap(HeightMap(heights_of(profile), R, (0, 0))).unsafe[:, 20]
    profile[30:33] = np.nan  # out of sight, as the camera comes along x
    hidden = foot_costmap(HeightMap(heights_of(profile), R, (0, 0))).unsafe[:, 20]
    assert hidden[29] and not hidden[:29].any()
    assert seen[28:30].all() and not seen[27]


def test_unknown_cells_are_unsafe_or_safe_as_set():
    heights = heights_of(np.zeros(40))
    heights[10:20, 10:20] = np.nan
    heights[30, 30] = np.nan  # a speckle hides nothing
    unsafe = foot_costmap(HeightMap(heights, R, (0, 0))).unsafe
    assert unsafe[np.isnan(heights)].all() and unsafe[9:21, 12:18].all()
    assert not unsafe[28:33, 28:33][np.arange(5) != 2].any() and not unsafe[:, 30][31:].any() and not unsafe[6].any()
    lenient = foot_costmap(HeightMap(heights, R, (0, 0)), CostmapSettings(unknown_unsafe=False))
    assert not lenient.unsafe.any()
    assert not lenient.known[15, 15] and lenient.known[5, 5]


def test_foot_cost_is_the_papers_equation():
    np.testing.assert_allclose(foot_cost([0.0, 0.03, 0.0999, 0.1, 0.4, np.inf], 0.1), [0.1, 0.07, 0.0001, 0, 0, 0])


def test_points_read_the_cell_they_lie_in_and_beyond_the_map_the_unknown():
    unsafe = np.zeros((50, 30), bool)
    unsafe[10, 5] = True
    costmap = costmap_from_mask(unsafe, R, center=(1.0, -2.0))
    corner = np.array([1.0 - 25 * R, -2.0 - 15 * R])
    np.testing.assert_allclose(costmap.lower_corner, corner)
    cell = corner + R * (np.array([10, 5]) + 0.5)
    points = cell + R * np.array([[0.49, -0.49], [1.0, 0.0], [0.0, 2.0], [100.0, 0.0]])
    np.testing.assert_allclose(costmap.distance_at(points), [0.0, R, 2 * R, 0.0], atol=1e-7)
    assert costmap.contains(cell) and not costmap.contains(points[3])
    lenient = costmap_from_mask(unsafe, R, center=(1.0, -2.0), unknown_unsafe=False)
    assert np.isinf(lenient.distance_at(points[3:])[0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"height_threshold_m": -0.1}, "height_threshold_m is -0.1"),
        ({"window_m": float("nan")}, "window_m"),
        ({"unknown_unsafe": "yes"}, "unknown_unsafe"),
    ],
)
def test_settings_out_of_range_are_named(change, words):
    with pytest.raises(MapError, match=words):
        CostmapSettings(**change)


@pytest.mark.parametrize(
    ("heights", "resolution", "center", "words"),
    [
        (np.zeros(5), R, (0, 0), "shape"),
        (np.full((5, 5), np.inf), R, (0, 0), "infinite"),
        (np.zeros((5, 5)), 0.0, (0, 0), "resolution_m"),
        (np.zeros((5, 5)), R, (0, np.nan), "center"),
        (np.array([["a"] * 5] * 5), R, (0, 0), "numbers"),
    ],
)
def test_a_map_that_makes_no_sense_is_refused(heights, resolution, center, words):
    with pytest.raises(MapError, match=words):
        HeightMap(heights, resolution, center)
