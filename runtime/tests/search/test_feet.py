"""The foothold search against a plain one, and what each of its answers must keep to."""

import dataclasses
import math

import numpy as np
import pytest
from plain_search import Plain
from small_worlds import exact, problem

from legtool_runtime.errors import PlannerError
from legtool_runtime.robot import MIRROR, TROT_PAIRS
from legtool_runtime.search.feet import FootPlanner, gait_table, next_phase
from legtool_runtime.search.settings import GAITS

MANY = math.inf


def plain(robot, settings, planner, given):
    world = planner._world(given)
    return Plain(robot, settings, world.points, world.price, given.surface.ground, given.surface.trunk)


def compare(robot, settings, gait, seeds, **world):
    planner, found = FootPlanner(robot, settings), 0
    for seed in seeds:
        given = problem(robot, settings, np.random.default_rng(seed), **world)
        answer = planner.plan(given, deadline_s=MANY, gaits=[gait])
        other = plain(robot, settings, planner, given)
        best = other.search(gait, 0, given.waypoint, settings.feet.tolerance)
        assert (answer.status == "found") == (best is not None), f"seed {seed}: {answer.status}, {best}"
        if best is None:
            continue
        found += 1
        assert answer.cost == pytest.approx(best[0], abs=1e-6), f"seed {seed}"
        total = 0.0
        for k in range(len(answer)):
            before, after = (tuple(answer.stances[k + i].tolist()) for i in range(2))
            swings = next(s for s in GAITS[gait][answer.phases[k]])
            assert other.fault(before, after, swings) == "", f"seed {seed}, transition {k}"
            total += other.cost(before, after, swings)
        assert total == pytest.approx(answer.cost, abs=1e-6)
    return found


@pytest.mark.parametrize("gait", ["trot", "walk"])
def test_a_plain_search_finds_paths_of_the_same_cost(anymal, gait):
    assert compare(anymal, exact(anymal), gait, range(25)) >= 10


@pytest.mark.parametrize("gait", ["trot", "walk"])
def test_a_plain_search_finds_paths_of_the_same_cost_for_a_small_robot(go2, gait):
    assert compare(go2, exact(go2), gait, range(1000, 1020)) >= 5


def test_a_plain_search_finds_paths_of_the_same_cost_by_the_papers_rules(anymal):
    assert compare(anymal, exact(anymal, "paper"), "trot", range(20)) >= 8


def test_a_weight_bounds_what_a_path_costs_more(anymal):
    best, hurried = (FootPlanner(anymal, exact(anymal)) for _ in range(2))
    feet = dataclasses.replace(hurried.settings.feet, weights=(3.0,))
    hurried.settings = dataclasses.replace(hurried.settings, feet=feet)
    found = 0
    for seed in range(100, 130):
        given = problem(anymal, best.settings, np.random.default_rng(seed))
        least, quick = best.plan(given, deadline_s=MANY), hurried.plan(given, deadline_s=MANY)
        assert (least.status == "found") == (quick.status == "found")
        if least.status == "found" and least.gait == quick.gait:
            found += 1
            assert least.cost - 1e-9 <= quick.cost <= 3.0 * least.cost
    assert found >= 10


def test_a_mirrored_world_has_a_mirrored_path(anymal):
    settings = exact(anymal, shank=-1.0, trunk=-1.0, apex=math.inf)
    planner, mirror, found = FootPlanner(anymal, settings), np.array([1.0, -1.0, 1.0]), 0
    for seed in range(200, 220):
        given = problem(anymal, settings, np.random.default_rng(seed))
        c = given.candidates
        other = dataclasses.replace(
            given,
            candidates=dataclasses.replace(c, points=c.points * mirror),
            feet=given.feet[list(MIRROR)] * mirror,
            waypoint=given.waypoint * mirror,
            swung=TROT_PAIRS[0],  # so that the pair swings first that is the mirror image of the first one
        )
        one, two = (planner.plan(p, deadline_s=MANY, gaits=["trot"]) for p in (given, other))
        assert one.status == two.status
        if one.status == "found":
            found += 1
            assert two.cost == pytest.approx(one.cost, abs=1e-9)
    assert found >= 5


def test_the_same_problem_has_the_same_answer(anymal):
    planner = FootPlanner(anymal, exact(anymal))
    given = problem(anymal, planner.settings, np.random.default_rng(1))
    one, two = (planner.plan(given, deadline_s=MANY, gaits=["trot"]) for _ in range(2))
    assert (one.stances == two.stances).all() and one.cost == two.cost


def test_a_gait_goes_on_after_the_legs_that_swung():
    assert next_phase("trot", None) == 0
    assert [next_phase("trot", pair) for pair in TROT_PAIRS] == [1, 0]
    assert [next_phase("walk", [leg]) for leg in (2, 0, 3, 1)] == [1, 2, 3, 0]
    assert next_phase("acyclic", [0]) == 0
    with pytest.raises(PlannerError, match="trot, walk, acyclic"):
        gait_table("gallop")


def test_an_acyclic_search_is_at_least_as_cheap_as_a_trot(anymal):
    planner, better = FootPlanner(anymal, exact(anymal)), 0
    for seed in range(4):
        given = problem(anymal, planner.settings, np.random.default_rng(seed))
        trot, free = (planner.plan(given, deadline_s=MANY, gaits=[g]) for g in ("trot", "acyclic"))
        if trot.status == "found":
            assert free.status == "found" and free.cost <= trot.cost + 1e-9
            better += 1
    assert better


@pytest.mark.slow
@pytest.mark.parametrize("gait", ["trot", "walk"])
@pytest.mark.parametrize("mode", ["walkable", "paper"])
def test_a_plain_search_agrees_on_thousands_of_worlds(anymal, go2, gait, mode):
    for robot, first in ((anymal, 10_000), (go2, 20_000)):
        assert compare(robot, exact(robot, mode), gait, range(first, first + 300)) >= 100
