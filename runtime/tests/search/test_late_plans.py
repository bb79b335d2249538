"""Plans that come late are joined to what the feet did meanwhile; their events are put off, never skipped."""

import itertools
import math

import numpy as np
import pytest

from legtool_runtime.search.late_plans import arrive
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance

SWING_S, STEP_S = 0.3, 0.4
PAIRS = ((0, 3), (1, 2))
UP = np.array([0.0, 0.0, 1.0])


def trot(steps, start_s=1.0, stride=0.1, from_step=0, shift=0.0):
    """A trot of ``steps`` half cycles; of the steps from ``from_step`` on the places are moved by ``shift``."""
    rows = [[Stance(-math.inf, math.inf, np.array([0.4 * (1 - leg // 2 * 2), 0.3 - 0.6 * (leg % 2), 0.0]), UP)]
            for leg in range(4)]  # fmt: skip
    for k in range(steps):
        lift = start_s + k * STEP_S
        for leg in PAIRS[k % 2]:
            before = rows[leg][-1]
            rows[leg][-1] = Stance(before.begin_s, lift, before.place, UP)
            place = np.add(before.place, (stride, shift if k >= from_step else 0.0, 0.0))
            rows[leg].append(Stance(lift + SWING_S, math.inf, place, UP))
    return ContactPlan(rows)


def lift_offs(plan):
    return sorted({s.end_s for row in plan.stances for s in row[:-1]})


def test_a_plan_in_time_is_followed_as_it_is():
    now, late = trot(2), trot(6, from_step=2, shift=0.05)
    arrival = arrive(late, now, clock_s=1.5)  # the second pair is in the air
    assert arrival.shift_s == 0.0 and arrival.reason == ""
    for row, wanted in zip(arrival.plan.stances, late.stances, strict=True):
        assert [(s.begin_s, s.end_s) for s in row] == [(s.begin_s, s.end_s) for s in wanted]
        np.testing.assert_array_equal([s.place for s in row], [s.place for s in wanted])


def test_what_has_landed_meanwhile_stays_where_it_landed():
    landed = np.array([0.52, 0.31, 0.01])
    now = trot(2).touched_down(0, 1.27, landed)
    arrival = arrive(trot(6), now, clock_s=1.35)
    stance = arrival.plan.stances[0][1]
    assert stance.begin_s == 1.27 and stance.end_s == trot(6).stances[0][1].end_s
    np.testing.assert_array_equal(stance.place, landed)


@pytest.mark.parametrize("late_s", [0.001, 0.15, 0.9])
def test_a_plan_whose_start_is_past_is_put_off_and_none_of_its_events_is_skipped_or_hurried(late_s):
    now, late = trot(2), trot(6)
    due = 1.0 + 2 * STEP_S  # when the third pair should have lifted; the robot stands, as its own plan is over
    arrival = arrive(late, now, clock_s=due + late_s, lead_s=0.1)
    assert arrival.shift_s == pytest.approx(late_s + 0.1)
    assert lift_offs(arrival.plan)[:2] == pytest.approx([1.0, 1.0 + STEP_S])
    assert lift_offs(arrival.plan)[2:] == pytest.approx([due + late_s + 0.1 + k * STEP_S for k in range(4)])
    assert arrival.plan.standing(due + late_s + 0.1 - 1e-6).all()
    swings = [b.begin_s - a.end_s for row in arrival.plan.stances for a, b in itertools.pairwise(row)]
    assert swings == pytest.approx([SWING_S] * len(swings))


def test_a_swing_that_has_begun_keeps_its_touchdown():
    now = ContactPlan([*trot(1).stances[:3], trot(1).stances[3]])
    crawl = [list(row) for row in trot(1).stances]
    first = crawl[1][0]  # a leg that should have lifted while the first pair was in the air
    crawl[1] = [Stance(-math.inf, 1.1, first.place, UP), Stance(1.4, math.inf, np.add(first.place, (0.1, 0, 0)), UP)]
    arrival = arrive(ContactPlan(crawl), now, clock_s=1.2, lead_s=0.0)
    assert arrival.shift_s == pytest.approx(0.1)
    assert arrival.plan.stances[0][1].begin_s == pytest.approx(1.3)
    assert arrival.plan.stances[1][0].end_s == pytest.approx(1.2)
    assert arrival.plan.stances[1][1].begin_s == pytest.approx(1.5)


def test_a_plan_that_does_not_know_a_swing_cannot_be_joined():
    arrival = arrive(trot(1), trot(2), clock_s=1.5)
    assert arrival.plan is None and "FR" in arrival.reason and "late plan does not know" in arrival.reason


def test_stances_that_the_tracker_has_forgotten_are_not_missed():
    now = trot(8).since(3.6)
    assert len(now.stances[0]) < len(trot(8).stances[0])
    arrival = arrive(trot(12), now, clock_s=3.85)
    assert arrival.plan is not None and len(lift_offs(arrival.plan)) > 4


def test_a_robot_that_stood_begins_late():
    arrival = arrive(trot(4), trot(0), clock_s=2.0)
    assert arrival.shift_s == pytest.approx(1.2)
    assert lift_offs(arrival.plan) == pytest.approx([2.2, 2.6, 3.0, 3.4])


def test_a_lift_off_that_the_walked_plan_has_too_needs_no_lead():
    assert arrive(trot(6), trot(4), clock_s=1.0 + 2 * STEP_S - 0.01).shift_s == 0.0
    assert arrive(trot(6), trot(2), clock_s=1.0 + 2 * STEP_S - 0.01, lead_s=0.2).shift_s == pytest.approx(0.19)
