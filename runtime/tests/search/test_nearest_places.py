"""The admissible place nearest to a heuristic foothold."""

import numpy as np
import pytest
from true_regions import cut, rectangle, regions_of

from legtool_runtime.foothold.gait import Gait
from legtool_runtime.search.nearest_places import cell_places, region_places
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.selectors import Wish

HIP_HEIGHT = 0.5


def wish(nominal, leg=0, yaw=0.0, hip=None, speed=0.0):
    hip = np.array([*nominal, HIP_HEIGHT]) if hip is None else np.asarray(hip, dtype=float)
    twist = (speed, 0.0, 0.0, 0.0, 0.0, 0.0)
    return Wish(leg, np.asarray(nominal, dtype=float), yaw, hip, twist, Gait(0.1, 1.5, 0.55, 0.3), np.inf)


def tilted(pitch):
    c, s = np.cos(pitch), np.sin(pitch)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def test_a_nominal_place_inside_stays_on_the_regions_plane(anymal):
    select = region_places(regions_of([rectangle((0, 0, 0.1), (2, 2), tilted(0.2))]), anymal)
    got = select(wish((0.3, 0.2)))
    assert got.point[:2] == pytest.approx([0.3, 0.2], abs=1e-3)
    assert got.point[2] == pytest.approx(0.1 - np.tan(0.2) * got.point[0], abs=1e-9)
    assert got.normal == pytest.approx(tilted(0.2)[:, 2])


def test_a_nominal_place_outside_moves_to_the_nearest_one_within_the_margin(anymal):
    select = region_places(regions_of([rectangle((0, 0, 0), (0.4, 0.2))]), anymal, margin_m=0.03)
    rng, inner = np.random.default_rng(0), np.array([0.17, 0.07])
    for nominal in rng.uniform(-0.35, 0.35, (50, 2)):
        got = select(wish(nominal, hip=(*np.clip(nominal, -inner, inner), 0.4)))
        assert got.point[:2] == pytest.approx(np.clip(nominal, -inner, inner), abs=2e-3)


def test_corners_are_reached_as_a_search_over_all_places_says(anymal):
    """Regions of any convex shape: Dykstra's projections end where a fine raster's best point lies."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        angles = np.sort(rng.uniform(0, 2 * np.pi, 6))
        if np.diff(np.append(angles, angles[0] + 2 * np.pi)).max() > 2.5:
            continue
        corners = 0.2 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        regions = regions_of([(np.eye(4), corners)])
        nominal = rng.uniform(-0.3, 0.3, 2)
        got = region_places(regions, anymal, margin_m=0.0)(wish(nominal, hip=(*nominal, 0.3)))
        x, y = np.meshgrid(np.linspace(-0.2, 0.2, 201), np.linspace(-0.2, 0.2, 201))
        edges = np.roll(corners, -1, axis=0) - corners
        inside = np.ones(x.shape, bool)
        for (ax, ay), (ex, ey) in zip(corners, edges, strict=True):
            inside &= ex * (y - ay) - ey * (x - ax) >= 0
        best = np.hypot(x - nominal[0], y - nominal[1])[inside].min()
        assert np.hypot(*(got.point[:2] - nominal)) == pytest.approx(best, abs=0.003)


def test_far_regions_and_those_too_small_for_the_margin_are_no_places(anymal):
    small = regions_of([rectangle((0, 0, 0), (0.05, 0.03))])
    assert region_places(small, anymal, margin_m=0.02)(wish((0.0, 0.0))) is None
    assert region_places(small, anymal, margin_m=0.01)(wish((0.0, 0.0))) is not None
    assert region_places(small, anymal, margin_m=0.01)(wish((0.8, 0.0))) is None
    assert region_places(regions_of([]), anymal)(wish((0.0, 0.0))) is None


def test_legs_are_not_stretched_or_set_inwards_for_a_little_less_way(anymal):
    """Two stones as far from the nominal place: the one nearer to the hip, and the one outwards."""
    stones = regions_of([rectangle((0.2, 0.0, 0), (0.2, 0.2)), rectangle((-0.2, 0.0, 0), (0.2, 0.2))])
    select = region_places(stones, anymal, margin_m=0.0)
    assert select(wish((0.0, 0.0), hip=(-0.3, 0.0, 0.5))).point[0] < 0
    assert select(wish((0.0, 0.0), hip=(0.3, 0.0, 0.5))).point[0] > 0
    beside = regions_of([rectangle((0.0, 0.2, 0), (0.2, 0.2)), rectangle((0.0, -0.2, 0), (0.2, 0.2))])
    for leg, side in ((0, 1), (1, -1), (2, 1), (3, -1)):
        got = region_places(beside, anymal, margin_m=0.0)(wish((0.0, 0.0), leg=leg, hip=(0.0, 0.0, 0.5)))
        assert side * got.point[1] > 0


def test_borders_of_superpixels_cost_the_margin_only(anymal):
    floor = rectangle((0, 0, 0), (2, 2))
    select = region_places(regions_of(list(cut(floor, 0.2, (0.0, 0.0)))), anymal)
    for nominal in np.random.default_rng(2).uniform(-0.5, 0.5, (30, 2)):
        assert np.hypot(*(select(wish(nominal)).point[:2] - nominal)) <= 0.03


def test_cells_of_a_map_are_stepped_on_where_they_are_allowed(anymal):
    heights = np.zeros((50, 50), np.float32)
    heights[30:] = 0.1
    ground, allowed = HeightMap(heights, 0.02, np.zeros(2)), np.ones((50, 50), bool)
    allowed[26:33] = False
    select = cell_places(ground, allowed, anymal)
    assert select(wish((-0.203, 0.114))).point == pytest.approx([-0.203, 0.114, 0.0])
    got = select(wish((0.04, 0.0), hip=(0.04, 0.0, 0.4))).point
    assert got[0] == pytest.approx(0.01) and got[2] == 0.0
    assert select(wish((0.3, 0.0))).point[2] == pytest.approx(0.1)
    assert cell_places(ground, np.zeros((50, 50), bool), anymal)(wish((0.0, 0.0))) is None
