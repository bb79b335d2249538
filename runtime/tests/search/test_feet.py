"""The foothold search against a plain one, and what each of its answers must keep to."""

import math

import numpy as np
import pytest
from plain_search import Plain
from small_worlds import exact, problem

from legtool_runtime.search.feet import FootPlanner
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


@pytest.mark.slow
@pytest.mark.parametrize("gait", ["trot", "walk"])
@pytest.mark.parametrize("mode", ["walkable", "paper"])
def test_a_plain_search_agrees_on_thousands_of_worlds(anymal, go2, gait, mode):
    for robot, first in ((anymal, 10_000), (go2, 20_000)):
        assert compare(robot, exact(robot, mode), gait, range(first, first + 300)) >= 100
