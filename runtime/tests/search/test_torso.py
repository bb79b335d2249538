"""Torso paths stand over ground, and the cost to go knows the ways around what does not carry."""

import dataclasses

import numpy as np
import pytest
from true_regions import rectangle, regions_of

from legtool_runtime.errors import PlannerError
from legtool_runtime.search.candidates import find_candidates
from legtool_runtime.search.field_kernels import cost_to_go
from legtool_runtime.search.settings import PipsSettings
from legtool_runtime.search.supports import nearest_yaw, torso_height, yaw_of
from legtool_runtime.search.torso import TorsoPlanner
from legtool_runtime.terrain.elevation import HeightMap

HEIGHT = 0.55


@pytest.fixture(scope="module")
def planner(anymal):
    return TorsoPlanner(anymal, dataclasses.replace(PipsSettings.of(anymal), height_m=HEIGHT))


def supports(planner, faces, position=(0.0, 0.0, HEIGHT), elevation=None):
    found, surface = find_candidates(
        regions_of(faces), position=position, settings=planner.settings.candidates, elevation=elevation
    )
    return planner.supports(found, surface, position)


def path(planner, given, goal, position=(0.0, 0.0, HEIGHT), yaw=0.0, **others):
    return planner.plan(given, position=position, yaw=yaw, goal=goal, **others)


def test_it_goes_straight_to_a_goal_on_flat_ground(planner):
    got = path(planner, supports(planner, [rectangle((0, 0, 0), (6, 6))]), (1.2, 0.0))
    assert got.status == "reached" and got.left_m == 0.0
    assert got.poses[0] == pytest.approx([0, 0, HEIGHT, 0])
    assert np.hypot(*(got.poses[-1, :2] - [1.2, 0.0])) < 0.15
    assert got.length_m < 1.4 and np.abs(got.poses[:, 3]).max() < 0.01
    assert got.poses[:, 2] == pytest.approx(HEIGHT)


def test_it_turns_where_a_heading_is_asked_for(planner):
    got = path(planner, supports(planner, [rectangle((0, 0, 0), (6, 6))]), (0.9, 0.0), goal_yaw=1.2)
    assert got.status == "reached" and abs(got.poses[-1, 3] - 1.2) < 0.4


def test_a_far_goal_ends_at_the_frontier_that_is_nearest_to_it(planner):
    got = path(planner, supports(planner, [rectangle((0, 0, 0), (6, 6))]), (9.0, 0.0))
    assert got.status == "frontier"
    assert got.poses[-1, 0] > 1.3 and abs(got.poses[-1, 1]) < 0.3


def test_heights_follow_the_ground(planner):
    stairs = [rectangle((-1, 0, 0), (3, 2))] + [rectangle((0.65 + 0.3 * k, 0, 0.1 * k), (0.3, 2)) for k in range(1, 5)]
    got = path(planner, supports(planner, stairs), (1.3, 0.0))
    assert got.poses[-1, 2] - HEIGHT == pytest.approx(0.2, abs=0.08)


def test_no_pose_stands_over_a_pit(planner):
    """A gap that no leg spans ends the way; beside it the way goes on."""
    shores = [rectangle((-1, 0, 0), (3, 6)), rectangle((2.7, 0, 0), (2.4, 6))]
    got = path(planner, supports(planner, shores), (2.0, 0.0))
    assert got.status == "frontier" and got.poses[-1, 0] < 0.5
    bridge = rectangle((1.0, 1.0, 0), (1.2, 0.6))
    got = path(planner, supports(planner, [*shores, bridge]), (2.0, 0.0), position=(0.2, 0.0, HEIGHT))
    between = got.poses[(got.poses[:, 0] > 0.9) & (got.poses[:, 0] < 1.1)]
    assert got.poses[-1, 0] > 1.2 and len(between) and between[:, 1].min() > 0.6


def test_the_path_keeps_to_a_winding_beam(planner):
    places = np.linspace(0, 3, 31)
    middle = 0.35 * np.sin(2 * np.pi * places / 3)
    beam = [rectangle((x, y, 0), (0.12, 0.5)) for x, y in zip(places, middle, strict=True)]
    got = path(planner, supports(planner, [rectangle((-1, 0, 0), (2, 2)), *beam]), (3.0, 0.0))
    on = got.poses[got.poses[:, 0] > 0.3]
    assert len(on) > 4
    assert np.abs(on[:, 1] - np.interp(on[:, 0], places, middle)).max() < 0.2


def test_the_trunk_passes_no_wall(planner):
    heights = np.zeros((200, 200), np.float32)
    heights[130:135, 60:200] = 1.0  # x = 0.6 to 0.7, y from -0.8 on
    wall = HeightMap(heights, 0.02, np.zeros(2))
    free = supports(planner, [rectangle((0, 0, 0), (6, 6))])
    walled = supports(planner, [rectangle((0, 0, 0), (6, 6))], elevation=wall)
    straight, around = path(planner, free, (1.4, 0.0)), path(planner, walled, (1.4, 0.0))
    assert np.abs(straight.poses[:, 1]).max() < 0.2
    passing = around.poses[np.abs(around.poses[:, 0] - 0.65) < 0.1]
    assert (passing[:, 1] < -0.8).all()


def test_it_says_when_there_is_no_ground_around(planner):
    got = path(planner, supports(planner, [rectangle((0, 0, 0), (0.2, 0.2))]), (2.0, 0.0))
    assert got.status == "enclosed" and len(got.poses) == 1


def test_a_waypoint_that_led_nowhere_is_left_for_another(planner):
    given = supports(planner, [rectangle((0, 0, 0), (6, 6))])
    first = path(planner, given, (9.0, 0.0)).poses[-1]
    tabu = np.array([[first[0], first[1], first[3], 2.0]])
    second = path(planner, given, (9.0, 0.0), tabu=tabu).poses[-1]
    assert np.hypot(*(second[:2] - first[:2])) > 0.25 or abs(second[3] - first[3]) > 0.7


def test_an_end_is_held_to_until_another_is_worth_clearly_more(planner):
    """Between ends that lead as near to the goal noise alone would decide anew in every frame."""
    y = 0.5 * planner.settings.torso.cell  # the lattice is the same to both sides of it
    here, goal, body = (0.0, y, HEIGHT), (4.0, y), rectangle((0, y, 0), (1.6, 2.4))
    stubs = [rectangle((1.1, y + side * 0.8, 0), (0.8, 0.7)) for side in (1, -1)]

    def end(faces, kept=None):
        return path(planner, supports(planner, faces, here), goal, here, kept=kept).poses[-1]

    first = end([body, *stubs])
    other = [first[0], 2 * y - first[1], first[2], -first[3]]
    assert abs(first[1] - y) > 0.3
    for kept in (first, other):
        assert end([body, *stubs], kept) == pytest.approx(kept)
    longer = rectangle((1.4, y + 0.8 * np.sign(first[1] - y), 0), (1.4, 0.7))
    assert (end([body, *stubs, longer], other)[1] - y) * (first[1] - y) > 0


def test_ground_that_is_only_assumed_is_avoided(planner):
    floor = [rectangle((0.5, 1.0, 0), (3, 2)), rectangle((0.5, -1.0, 0), (3, 2))]
    found, surface = find_candidates(regions_of(floor), position=(0, 0, HEIGHT), settings=planner.settings.candidates)
    doubtful = dataclasses.replace(found, assumed=found.points[:, 1] < -0.15)
    got = path(planner, planner.supports(doubtful, surface, (0, 0)), (1.5, -0.2))
    plain = path(planner, planner.supports(found, surface, (0, 0)), (1.5, -0.2))
    assert got.poses[:, 1].mean() > plain.poses[:, 1].mean() + 0.05


def test_support_is_asked_for_at_each_foot(planner):
    given = supports(planner, [rectangle((0, 0, 0), (6, 6))])
    for yaw in (0.0, 1.0, -2.0):
        assert torso_height(given, 0.1, 0.2, nearest_yaw(yaw))[0] == pytest.approx(HEIGHT)
    corner = supports(planner, [rectangle((1.5, 1.5, 0), (3, 3))])
    assert torso_height(corner, 0.0, 0.0, nearest_yaw(0.0))[0] == -np.inf
    assert yaw_of(nearest_yaw(0.4)) == pytest.approx(np.pi / 8)


def test_the_cost_to_go_is_the_way_less_the_tolerance(planner):
    given = supports(planner, [rectangle((0, 0, 0), (6, 6))])
    field = planner.field(given, position=(0, 0), yaw=0.0, waypoint=(1.2, 0.0, HEIGHT, 0.0))
    tolerance = planner.settings.feet.tolerance
    for x in (0.0, 0.3, 0.6):
        assert cost_to_go(field, x, 0.0, 0.0) == pytest.approx(1.2 - x - tolerance, abs=0.13)
    assert cost_to_go(field, 1.2, 0.0, 0.0) == 0.0
    turned = planner.field(given, position=(0, 0), yaw=0.0, waypoint=(1.2, 0.0, HEIGHT, 1.6), yaw_matters=True)
    assert cost_to_go(turned, 1.2, 0.0, 0.0) > 0.05


def test_the_cost_to_go_knows_the_way_around_a_pit(planner):
    island = [rectangle((-1, 0, 0), (2.4, 6)), rectangle((2.3, 0, 0), (1.4, 6)), rectangle((0.9, 1.0, 0), (1.6, 0.8))]
    given = supports(planner, island)
    field = planner.field(given, position=(0, 0), yaw=0.0, waypoint=(1.7, 0.0, HEIGHT, 0.0))
    free = planner.settings.feet.tolerance
    assert cost_to_go(field, 0.0, 0.0, 0.0) > 1.7 - free + 0.2


@pytest.mark.parametrize("values", [{"goal": (np.nan, 0.0)}, {"yaw": np.inf}, {"position": (0.0, 0.0, np.nan)}])
def test_values_that_are_not_finite_are_refused(planner, values):
    given = supports(planner, [rectangle((0, 0, 0), (3, 3))])
    with pytest.raises(PlannerError, match="not finite"):
        planner.plan(given, **{"position": (0, 0, HEIGHT), "yaw": 0.0, "goal": (1.0, 0.0), **values})


def test_wider_support_carries_poses_whose_ideal_feet_are_farther_from_footholds(planner):
    beam = [rectangle((0.5, 0.03, 0), (4, 0.26))]
    found, surface = find_candidates(
        regions_of(beam), position=(0.0, 0.0, HEIGHT), settings=planner.settings.candidates
    )
    widths = [planner.supports(found, surface, (0.0, 0.0, HEIGHT), wider=wider) for wider in (1.0, 1.5, 2.0)]
    known = [int(np.isfinite(s.height).sum()) for s in widths]
    assert known[0] < known[1] < known[2]
    assert path(planner, widths[1], (1.2, 0.0)).status == "reached"
