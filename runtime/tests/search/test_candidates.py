"""Candidates lie in regions, keep off real edges, and come back from frame to frame."""

import dataclasses

import numpy as np
import pytest
from true_regions import cut, rectangle, regions_of

from legtool_runtime.errors import PlannerError
from legtool_runtime.search.candidates import find_candidates, keys_of
from legtool_runtime.search.settings import CandidateSettings
from legtool_runtime.terrain.elevation import HeightMap

SETTINGS = CandidateSettings(radius=1.0)


def found(faces, assumed=None, settings=SETTINGS, position=(0.0, 0.0, 0.5), elevation=None):
    return find_candidates(regions_of(faces, assumed), position=position, settings=settings, elevation=elevation)[0]


def slope(pitch):
    c, s = np.cos(pitch), np.sin(pitch)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def test_candidates_lie_on_the_lattice_within_reach_and_on_their_planes():
    got = found([rectangle((0, 0, 0.1), (3, 3), slope(0.3))])
    assert len(got) > 200
    assert np.hypot(*got.points[:, :2].T).max() <= 1.0
    cells = got.points[:, :2] / 0.05 - 0.5
    assert np.abs(cells - cells.round()).max() < 1e-9
    assert got.points[:, 2] == pytest.approx(0.1 - np.tan(0.3) * got.points[:, 0], abs=1e-9)
    assert got.normals == pytest.approx(np.tile(slope(0.3)[:, 2], (len(got), 1)))


def test_margins_are_distances_to_the_edge_of_a_stone():
    got = found([rectangle((0.02, -0.01, 0.0), (0.16, 0.12))])
    assert len(got) >= 2
    x, y = np.abs(got.points[:, :2] - [0.02, -0.01]).T
    true = np.minimum(0.08 - x, 0.06 - y)
    assert np.abs(got.margins - true).max() <= 0.011  # half of a raster's cell, and a little


def test_borders_of_superpixels_are_no_edges():
    floor = rectangle((0, 0, 0), (4, 4))
    whole = found([floor])
    for side, shift in ((0.2, (0, 0)), (0.17, (0.05, 0.03))):
        pieces = found(list(cut(floor, side, shift)))
        inner = [np.hypot(*c.points[:, :2].T) < 0.9 for c in (pieces, whole)]
        assert set(pieces.keys[inner[0]]) == set(whole.keys[inner[1]])
        assert pieces.margins[inner[0]] == pytest.approx(whole.margins[inner[1]])


def test_gaps_between_superpixels_of_one_plane_are_seams_and_wider_ones_edges():
    narrow = [rectangle((-0.51, 0, 0), (1, 2)), rectangle((0.51, 0, 0), (1, 2))]
    wide = [rectangle((-0.54, 0, 0), (1, 2)), rectangle((0.54, 0, 0), (1, 2))]
    step = [rectangle((-0.51, 0, 0), (1, 2)), rectangle((0.51, 0, 0.1), (1, 2))]
    near = lambda c: c.margins[(np.abs(c.points[:, 0]) < 0.1) & (np.abs(c.points[:, 1]) < 0.5)]  # noqa: E731
    assert near(found(narrow)).min() == pytest.approx(0.1)
    assert near(found(wide)).min() < 0.05
    assert near(found(step)).min() < 0.06


def test_keys_survive_another_segmentation():
    kept, future = 0, 0
    floor = rectangle((0.3, 0, 0), (3, 1.4), slope(0.1))
    rng = np.random.default_rng(0)
    first = set(found(list(cut(floor, 0.2))).keys)
    for _ in range(20):
        again = set(found(list(cut(floor, rng.uniform(0.15, 0.25), rng.uniform(0, 0.2, 2)))).keys)
        kept, future = kept + len(first & again), future + len(first)
    assert kept >= 0.99 * future


def test_noise_does_not_change_the_keys_of_a_floor():
    places = np.array([[0.125, 0.025, 0.0], [0.225, -0.075, 0.1]])
    noise = np.array([[0.0, 0.0, 0.01]])
    assert (keys_of(places + noise, 0.1) == keys_of(places - noise, 0.1)).all()
    assert len(set(keys_of([[0, 0, 0], [0, 0, 0.1], [0.1, 0, 0], [-0.1, 0, 0]], 0.1))) == 4


def test_a_small_region_gets_its_chebyshev_centre():
    # Between the lattice's points: 4 cm wide.
    got = found([rectangle((0.1, 0.2, 0.0), (0.045, 0.04))], settings=CandidateSettings(radius=1.0, cell=0.005))
    assert len(got) == 1
    assert got.points[0] == pytest.approx([0.1, 0.2, 0.0], abs=2e-3)


def test_of_surfaces_over_each_other_the_upper_one_counts():
    got = found([rectangle((0, 0, 0), (1, 1)), rectangle((0, 0, 0.3), (0.4, 0.4))])
    inside = np.abs(got.points[:, :2]).max(axis=1) < 0.2
    assert inside.any() and (got.points[inside, 2] == 0.3).all()
    assert (got.points[~inside, 2] == 0.0).all()


def test_what_stands_on_a_region_is_an_edge():
    heights = np.zeros((100, 100), np.float32)
    heights[50:52] = 0.1  # a barrier across x = 0 to 0.04
    elevation = HeightMap(heights, 0.02, np.zeros(2))
    got = found([rectangle((0, 0, 0), (3, 3))], elevation=elevation)
    off = np.maximum(np.maximum(-got.points[:, 0], got.points[:, 0] - 0.04), 0.0)
    off = off[np.abs(got.points[:, 1]) < 0.8]
    assert off.min() >= 0.014


def test_steep_regions_and_far_assumed_ones_are_left_out():
    assert len(found([rectangle((0, 0, 0), (1, 1), slope(0.7))])) == 0
    near, far = rectangle((0.3, 0, 0), (0.3, 0.3)), rectangle((0.8, 0, 0), (0.3, 0.3))
    got = found([near, far], assumed=[True, True])
    assert len(got) > 0 and got.assumed.all() and got.points[:, 0].max() < 0.5
    assert len(found([near, far])) > len(got)


def test_candidates_are_thinned_to_those_near_a_path_and_the_others_counted():
    every = found([rectangle((0, 0, 0), (3, 3))])
    some = every.near([[0.0, 0.0], [0.5, 0.0]], 50)
    assert len(some) == 50 and some.dropped == len(every) - 50
    way = lambda p: np.hypot(np.maximum(0.0, np.abs(p[:, 0] - 0.25) - 0.25), p[:, 1])  # noqa: E731
    assert way(some.points).max() < 0.4
    assert every.near([[0, 0]], 10_000) is every


def test_a_centroid_for_each_region_as_in_the_paper():
    pieces = list(cut(rectangle((0, 0, 0), (1, 1)), 0.2))
    got = found(pieces, settings=CandidateSettings(radius=1.0, centroids=True))
    assert sorted(map(tuple, got.points.round(6))) == sorted(tuple(p[:3, 3].round(6)) for p, _ in pieces)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p, c: (p, c[::-1]), "clockwise"),
        (lambda p, c: (p, c[[0, 1]]), "3 corners"),
        (lambda p, c: (p, np.array([[0, 0], [1, 0], [0.2, 0.2], [0, 1.0]])), "convex"),
        (lambda p, c: (p, c * np.nan), "not finite"),
        (lambda p, c: (p * np.nan, c), "not finite"),
        (lambda p, c: (p, 0.0 * c), "no area"),
        (lambda p, c: (p, c * [1.0, 0.0]), "no area"),
        (lambda p, c: (np.diag([2.0, 2.0, 2.0, 1.0]), c), "rotation"),
        (lambda p, c: (np.diag([-1.0, 1.0, 1.0, 1.0]), c), "rotation"),
    ],
)
def test_regions_that_cannot_be_used_are_refused_in_one_line(change, words):
    face = rectangle((0, 0, 0), (1, 1))
    with pytest.raises(PlannerError, match=words) as refusal:
        found([rectangle((0.5, 0, 0), (0.5, 1)), change(*face)])
    assert "\n" not in str(refusal.value) and "region 1" in str(refusal.value)


def test_a_boundary_of_another_shape_is_refused_in_one_line():
    flat = regions_of([rectangle((0, 0, 0), (1, 1))])
    solid = dataclasses.replace(flat, boundaries=(np.zeros((4, 3)),))
    with pytest.raises(PlannerError, match=r"boundary of region 0 has shape \(4, 3\)"):
        find_candidates(solid, position=(0.0, 0.0, 0.5))


def test_no_regions_give_no_candidates():
    assert len(found([])) == 0


@pytest.mark.parametrize("shift", [0.0, 0.02, 0.04, 0.06, 0.08])
def test_a_narrow_beam_has_lanes_as_far_apart_as_a_stance_is_wide(shift):
    """0.3 m wide, and feet that stand 0.015 m from its edges at least: lanes 0.2 m apart at every place."""
    got = found([rectangle((0, shift, 0), (3, 0.30))])
    for x in np.arange(-0.7, 0.71, 0.1):
        y = got.points[np.abs(got.points[:, 0] - x) <= 0.051, 1]
        assert y.max() - y.min() >= 0.2 - 1e-9


def test_a_planned_foothold_stays_a_candidate_while_half_of_the_least_margin_is_left():
    earlier = found([rectangle((0, 0, 0), (1.0, 0.12))])
    lane = (np.abs(np.abs(earlier.points[:, 1]) - 0.025) < 1e-9) & (np.abs(earlier.points[:, 0]) > 0.1)
    planned = earlier.points[lane][:6]

    def later(width, height=0.0, places=planned):
        regions = regions_of([rectangle((0, 0, height), (1.0, width))])
        got, surface = find_candidates(regions, position=(0.0, 0.0, 0.5), settings=SETTINGS)
        return got, got.with_held(earlier, places, surface, SETTINGS)

    got, held = later(0.08)  # their margin is 1.5 cm now, of 2 cm that are asked for
    assert not np.isin(earlier.keys[lane], got.keys).any()
    assert set(held.keys) - set(got.keys) == set(earlier.keys[lane][:6])
    assert held.margins[len(got) :] == pytest.approx(0.015, abs=0.002)
    for given in ({"width": 0.05}, {"width": 0.12, "height": 0.1}):  # too near to the edge; at another height
        got, held = later(**given)
        assert len(held) == len(got)
    assert len(later(0.08, places=np.empty((0, 3)))[1]) == len(later(0.08)[0])  # none but those of the plan
