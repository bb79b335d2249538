"""Feet in the air land where they catch a body that is off its way."""

import math

import numpy as np
import pytest

from legtool_runtime.tracking.contact_plan import ContactPlan, Stance
from legtool_runtime.tracking.reassign import Footholds, reassigned

UP = np.array([0.0, 0.0, 1.0])
OMEGA, CLOCK_S, LANDS_S = math.sqrt(9.81 / 0.55), 0.1, 0.3
OFF = np.array([0.0, 0.06])
#: How far off the body is when the feet land.
THEN = OFF * math.exp(OMEGA * (LANDS_S - CLOCK_S))


@pytest.fixture
def plan(anymal):
    """A trot whose first pair swings 10 cm ahead."""
    stand = anymal.stance * [1.0, 1.0, 0.0]
    rows = [[Stance(-math.inf, math.inf, place, UP)] for place in stand]
    for leg in (0, 3):
        rows[leg] = [
            Stance(-math.inf, 0.0, stand[leg], UP),
            Stance(LANDS_S, math.inf, stand[leg] + [0.1, 0.0, 0.0], UP, 0.3),
        ]
    return ContactPlan(rows)


def grid(height=0.0):
    x, y = np.meshgrid(np.arange(-0.8, 0.81, 0.05), np.arange(-0.6, 0.61, 0.05), indexing="ij")
    points = np.stack([x, y, np.full_like(x, height)], axis=-1).reshape(-1, 3)
    return Footholds(points, np.tile(UP, (len(points), 1)))


def ask(plan, robot, footholds, off=OFF, legs=(0, 3)):
    return reassigned(plan, CLOCK_S, off, omega=OMEGA, legs=legs, footholds=footholds, robot=robot)


def test_both_feet_go_as_far_to_the_side_as_the_body_will_be(plan, anymal):
    got = ask(plan, anymal, grid())
    for leg in (0, 3):
        way = got.stances[leg][1].place - plan.stances[leg][1].place
        assert np.hypot(*(way[:2] - THEN)) <= 0.036  # half of the grid's diagonal
        assert got.stances[leg][1].begin_s == LANDS_S
    assert got.stances[1] == plan.stances[1] and got.stances[2] == plan.stances[2]


def test_only_legs_that_are_named_and_places_that_are_offered_count(plan, anymal):
    got = ask(plan, anymal, grid(), legs=(3,))
    assert got.stances[0][1].place.tolist() == plan.stances[0][1].place.tolist()
    one = Footholds(plan.stances[0][1].place[None] + [0.0, 0.08, 0.0], UP[None])
    got = ask(plan, anymal, one)
    assert got.stances[0][1].place.tolist() == one.points[0].tolist()
    assert got.stances[3][1].place.tolist() == plan.stances[3][1].place.tolist()


@pytest.mark.parametrize(
    ("footholds", "off"),
    [
        (grid(height=0.2), OFF),  # on another level
        (Footholds(np.empty((0, 3)), np.empty((0, 3))), OFF),
        (grid(), np.array([0.0, 0.005])),  # nothing is better by 2 cm
    ],
    ids=["level", "none", "small"],
)
def test_without_a_better_place_the_plan_stays(plan, anymal, footholds, off):
    assert ask(plan, anymal, footholds, off=off) is None


def test_no_foot_crosses_another_or_leaves_what_its_leg_reaches(plan, anymal):
    for angle in np.arange(0.0, 2.0 * np.pi, 0.5):
        got = ask(plan, anymal, grid(), off=0.5 * np.array([np.cos(angle), np.sin(angle)]))
        assert got is None or ContactPlan(got.stances, robot=anymal)
