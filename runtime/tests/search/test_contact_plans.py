"""Contact plans from paths of stances, and what of a plan is kept."""

import math

import numpy as np
import pytest
from true_regions import rectangle, regions_of

from legtool_runtime.robot import TROT_PAIRS
from legtool_runtime.search.contact_plans import committed, contact_plan, last_places, remaining, timing_of
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance


@pytest.fixture(scope="module")
def steps(walker, anymal):
    walker.reset()
    floor = regions_of([rectangle((0, 0, 0), (8, 8))])
    feet = anymal.stance * [1.0, 1.0, 0.0]
    out = walker.plan(floor, position=(0, 0, 0.55), yaw=0.0, feet=feet, goal=(5.0, 0.3), time_s=0.0)
    assert out.feet.status == "found" and out.feet.gait == "trot"
    return out.feet


def test_feet_of_a_transition_swing_together_and_land_where_the_path_says(steps, anymal):
    plan, timing = contact_plan(steps, start_s=1.0, robot=anymal), timing_of("trot")
    lift = 1.0
    counts = [0] * 4
    for k, stays in enumerate(steps.families):
        moved = np.flatnonzero(~stays)
        if not len(moved):
            continue
        assert set(moved) <= set(TROT_PAIRS[steps.phases[k]])
        for leg in moved:
            counts[leg] += 1
            stance = plan.stances[leg][counts[leg]]
            assert stance.begin_s == pytest.approx(lift + timing.swing_s)
            assert plan.stances[leg][counts[leg] - 1].end_s == pytest.approx(lift)
            assert stance.place == pytest.approx(steps.positions[k + 1, leg])
        lift += timing.step_s
    assert [len(row) - 1 for row in plan.stances] == counts and sum(counts) > 8
    assert last_places(plan)[0] == pytest.approx(steps.positions[-1])
    assert all(row[0].begin_s == -math.inf and row[-1].end_s == math.inf for row in plan.stances)


def test_durations_go_with_the_root_of_the_robots_size(steps):
    usual, small = timing_of("trot"), timing_of("trot", 0.49)
    assert small.swing_s == pytest.approx(0.7 * usual.swing_s)
    assert small.full_stance_s == pytest.approx(0.7 * usual.full_stance_s)
    assert small.groups == usual.groups and timing_of("walk", 0.49).groups == timing_of("walk").groups
    swings = contact_plan(steps, start_s=0.0).end_s, contact_plan(steps, start_s=0.0, size=0.49).end_s
    assert swings[1] == pytest.approx(0.7 * swings[0])


def test_what_has_begun_is_kept_and_what_lifts_later_is_not(steps):
    plan = contact_plan(steps, start_s=1.0)
    until = 1.0 + 1.5 * timing_of("trot").step_s
    kept = committed(plan, until, 0.08)
    for leg, row in enumerate(kept.plan.stances):
        for k, stance in enumerate(row):
            whole = plan.stances[leg][k]
            assert stance.place == pytest.approx(whole.place) and stance.begin_s == whole.begin_s
            assert stance.end_s == (whole.end_s if whole.end_s < until else math.inf)
    touchdowns = [s.begin_s for row in kept.plan.stances for s in row if math.isfinite(s.begin_s)]
    assert kept.ready_s == pytest.approx(max(touchdowns) + 0.08)
    last = {leg for leg, row in enumerate(kept.plan.stances) if row[-1].begin_s == max(touchdowns)}
    assert set(kept.swung) == last


def test_a_robot_that_stands_has_nothing_to_keep(anymal):
    up = np.array([0.0, 0.0, 1.0])
    plan = ContactPlan([[Stance(-math.inf, math.inf, foot, up)] for foot in anymal.stance])
    kept = committed(plan, 3.0, 0.08)
    assert kept.ready_s == 3.0 and kept.swung is None and not remaining(kept.plan, 0.0)


def test_a_plan_goes_on_after_what_is_kept(steps, walker, anymal):
    """The next frame's plan begins where the kept part ends, with the other pair."""
    first = contact_plan(steps, start_s=1.0)
    floor = regions_of([rectangle((0, 0, 0), (8, 8))])
    out = walker.plan(
        floor, position=(0.1, 0, 0.55), yaw=0.0, feet=anymal.stance * [1.0, 1.0, 0.0], goal=(5.0, 0.3), time_s=1.1,
        plan=first,
    )  # fmt: skip
    kept = committed(first, 1.1 + walker.settings.commit_s, 0.08)
    for leg in range(4):
        for k, stance in enumerate(kept.plan.stances[leg]):
            assert out.plan.stances[leg][k].place == pytest.approx(stance.place)
            assert out.plan.stances[leg][k].begin_s == stance.begin_s
    lifts = [s.end_s for row in out.plan.stances for s in row if kept.ready_s - 1e-9 <= s.end_s < math.inf]
    assert min(lifts) == pytest.approx(kept.ready_s)
    following = {leg for leg, row in enumerate(out.plan.stances) for s in row if s.end_s == min(lifts)}
    assert not following & set(kept.swung)


def test_feet_that_stood_before_what_is_left_of_a_plan_count(steps):
    """The tracker forgets what is long over: of each leg a stance is left, with the time of its touchdown."""
    plan = contact_plan(steps, start_s=1.0)
    whole, left = committed(plan, 50.0, 0.08), committed(plan.since(49.0), 50.0, 0.08)
    assert left.swung == whole.swung and left.ready_s == whole.ready_s
