import numpy as np
import pytest

from legtool_runtime.errors import MapError
from legtool_runtime.terrain.conditioning import fill_hidden, without_speckle
from legtool_runtime.terrain.elevation import HeightMap


def stairs(hidden: slice, low: float = 0.0, high: float = 0.1) -> HeightMap:
    """High ground for x below the middle, low ground beyond, and cells between that no ray has reached."""
    heights = np.full((30, 20), low, np.float32)
    heights[:15] = high
    heights[hidden] = np.nan
    return HeightMap(heights, 0.02, np.zeros(2))


def test_what_an_edge_hides_lies_on_the_line_of_sight() -> None:
    filled = fill_hidden(stairs(slice(15, 19))).heights
    assert np.isfinite(filled).all()
    np.testing.assert_allclose(filled[14:20, 7], [0.1, 0.08, 0.06, 0.04, 0.02, 0.0], atol=1e-6)


def test_what_was_seen_stays() -> None:
    before = stairs(slice(15, 19))
    known = np.isfinite(before.heights)
    assert np.array_equal(fill_hidden(before).heights[known], before.heights[known])


def test_a_gap_between_ground_of_one_height_stays_unknown() -> None:
    filled = fill_hidden(stairs(slice(12, 15), low=0.1)).heights
    assert np.isnan(filled[12:15]).all()


def test_a_wide_unseen_stretch_stays_unknown() -> None:
    assert np.isnan(fill_hidden(stairs(slice(15, 23)), widest_m=0.12).heights[15:23]).all()


def test_of_two_lines_of_sight_the_lower_counts() -> None:
    heights = np.zeros((9, 9), np.float32)
    heights[:, :4], heights[4:6, :4] = 0.2, 0.1
    heights[4, 4] = np.nan
    heights[3, 4] = 0.3
    alone = fill_hidden(HeightMap(heights, 0.02, np.zeros(2))).heights[4, 4]
    assert alone == pytest.approx(0.05)


def test_the_map_it_was_made_from_is_not_changed() -> None:
    before = stairs(slice(15, 19))
    fill_hidden(before)
    assert np.isnan(before.heights[15:19]).all()


@pytest.mark.parametrize("name", ["widest_m", "least_step_m"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_width_or_step_that_is_none_is_refused(name: str, value: float) -> None:
    with pytest.raises(MapError, match=name):
        fill_hidden(stairs(slice(15, 19)), **{name: value})


def test_speckle_goes_and_edges_stay() -> None:
    clean = stairs(slice(0, 0))
    heights = clean.heights.copy()
    heights[5, 5], heights[22, 9] = 0.13, np.float32(-0.04)
    out = without_speckle(HeightMap(heights, 0.02, np.zeros(2))).heights
    np.testing.assert_allclose(out, clean.heights)


def test_unknown_cells_stay_unknown_and_lonely_ones_stay_as_they_are() -> None:
    heights = np.full((9, 9), np.nan, np.float32)
    heights[4, 4], heights[4, 5] = 0.2, 0.5
    out = without_speckle(HeightMap(heights, 0.02, np.zeros(2))).heights
    assert np.array_equal(out, heights, equal_nan=True)


def test_noise_of_the_heights_becomes_less() -> None:
    heights = np.random.default_rng(0).normal(0.0, 0.004, (60, 60)).astype(np.float32)
    out = without_speckle(HeightMap(heights, 0.02, np.zeros(2))).heights
    assert out.std() < 0.5 * heights.std()


@pytest.mark.parametrize("unknown", [0.0, 0.03, 0.4])
def test_heights_become_the_medians_of_what_is_known_around_them(unknown) -> None:
    rng = np.random.default_rng(3)
    heights = rng.normal(scale=0.02, size=(23, 31)).astype(np.float32)
    heights[rng.random(heights.shape) < unknown] = np.nan
    expected = heights.copy()
    for i, j in np.argwhere(~np.isnan(heights)):
        near = heights[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
        near = near[~np.isnan(near)]
        if len(near) >= 5:
            expected[i, j] = np.median(near)
    np.testing.assert_array_equal(without_speckle(HeightMap(heights, 0.02, np.zeros(2))).heights, expected)
