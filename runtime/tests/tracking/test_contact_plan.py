from dataclasses import replace

import numpy as np
import pytest
from stones_and_bodies import stones

from legtool_runtime.errors import LegtoolError, TrackingError
from legtool_runtime.robot import LEGS
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance, foot_at, stance_at
from legtool_runtime.tracking.gaits import CRAWL, TROT, GaitTiming, plan_from_gait, walked_on

UP = np.array([0.0, 0.0, 1.0])
INF = float("inf")


def standing(robot):
    return [[Stance(-INF, INF, np.array([*robot.stance[leg, :2], 0.0]), UP)] for leg in range(4)]


@pytest.fixture(scope="module")
def trot(anymal):
    return plan_from_gait(GaitTiming.trot(), stones(anymal, 5, np.random.default_rng(1)), start_s=1.0, robot=anymal)


def test_a_trot_swings_its_diagonals_in_turn(trot):
    assert trot.standing(0.5).all()
    assert trot.standing(1.2).tolist() == [False, True, True, False]
    assert trot.standing(1.45).all()
    assert trot.standing(1.7).tolist() == [True, False, False, True]
    assert trot.standing(99.0).all()
    assert trot.start_s == 1.0


def test_times_of_a_swing_are_told_while_it_lasts(trot):
    assert trot.lift_off_s(0, 0.3) == 1.0
    assert trot.lift_off_s(0, 1.2) == 1.0
    assert trot.touchdown_s(0, 1.2) == pytest.approx(1.4)
    assert trot.swing_phase(0, 1.1) == pytest.approx(0.25)
    assert trot.swing_phase(1, 1.1) == 0.0
    assert trot.touchdown_s(0, 99.0) == INF
    assert trot.current(0, 1.2) is None
    assert trot.next(0, 1.2).place[0] > trot.last(0, 1.2).place[0]


def test_a_crawl_swings_one_leg_at_a_time(anymal):
    plan = plan_from_gait(GaitTiming.crawl(), stones(anymal, 3, np.random.default_rng(1)), start_s=0.0)
    for t in np.arange(0.01, plan.end_s, 0.02):
        assert (~plan.standing(t)).sum() <= 1
    assert [int(np.argmin(plan.standing(0.3 + 0.75 * k))) for k in range(4)] == [legs[0] for legs in CRAWL]


def test_faster_trots_step_more_often():
    slow, fast = GaitTiming.trot_at(0.2), GaitTiming.trot_at(0.5)
    assert slow.cycle_s == pytest.approx(1 / 1.4)
    assert fast.cycle_s == pytest.approx(1 / 1.7)
    assert slow.stance_s / slow.cycle_s == pytest.approx(0.54)
    assert slow.groups == TROT


def test_a_stopped_clock_shifts_what_is_to_come_and_nothing_else(trot):
    waiting = trot.delayed(0.13, after_s=1.2)
    assert (waiting.standing(1.2) == trot.standing(1.2)).all()
    assert waiting.lift_off_s(0, 1.2) == 1.0
    assert waiting.touchdown_s(0, 1.2) == pytest.approx(1.53)
    for t in np.arange(1.21, 5.0, 0.01):
        assert (waiting.standing(t + 0.13) == trot.standing(t)).all()
    with pytest.raises(TrackingError, match="wait"):
        trot.delayed(-0.1, after_s=1.0)
    with pytest.raises(TrackingError, match="wait"):
        trot.delayed(float("nan"), after_s=1.0)


def test_legs_that_swing_again_let_all_others_wait(trot):
    again = trot.swung_again([0, 3], 1.42, 0.3)  # lifted off at 1.0, should have stood at 1.4
    assert again.standing(1.42).tolist() == [False, True, True, False]
    assert again.swing_phase(0, 1.42 + 1e-9) == pytest.approx(0.0, abs=1e-6)
    assert again.touchdown_s(0, 1.42) == again.touchdown_s(3, 1.42) == pytest.approx(1.72)
    for t in np.arange(1.41, 5.0, 0.01):
        assert (again.standing(t + 0.32) == trot.standing(t)).all()
    with pytest.raises(TrackingError, match="no swing to do again"):
        trot.swung_again([0], 0.5, 0.3)


def test_a_leg_that_lost_the_ground_swings_to_where_it_stood(trot):
    """Its stance began before stances of legs that have lifted since: those are past, and stay."""
    time_s = 2.5 * trot.stances[0][1].begin_s
    legs = [leg for leg in range(4) if trot.index(leg, time_s) is None]
    lost = next(leg for leg in range(4) if leg not in legs)
    k = trot.index(lost, time_s)
    assert legs and k and trot.stances[lost][k].begin_s < time_s - 0.1
    again = trot.swung_again([*legs, lost], time_s, 0.3)
    assert again.standing(time_s - 0.06)[lost] and not again.standing(time_s + 1e-9)[lost]
    assert again.touchdown_s(lost, time_s + 1e-9) == pytest.approx(time_s + 0.3)
    assert again.next(lost, time_s).place.tolist() == trot.stances[lost][k].place.tolist()
    others = [leg for leg in range(4) if leg not in legs]
    for t in np.arange(trot.start_s, time_s, 0.01):
        assert (again.standing(t) == trot.standing(t))[others].all()


def test_an_early_touchdown_begins_the_stance_at_once(trot):
    early = trot.touched_down(0, 1.33, [0.7, 0.3, 0.02])
    assert early.standing(1.33)[0]
    assert not early.standing(1.32)[0]
    assert early.current(0, 1.34).place.tolist() == [0.7, 0.3, 0.02]
    assert early.lift_off_s(0, 1.34) == trot.lift_off_s(0, 1.45)
    assert trot.touched_down(1, 1.2) is trot  # it stands already


def test_a_place_moves_as_far_as_it_may(anymal):
    plan = plan_from_gait(GaitTiming(), stones(anymal, 2, np.random.default_rng(1)), start_s=0.0, movable_m=0.05)
    place = plan.stances[0][1].place
    moved = plan.moved(0, 1, place + np.array([0.03, 0, 0]))
    assert moved.stances[0][1].place[0] == pytest.approx(place[0] + 0.03)
    assert moved.stances[0][1].movable_m == pytest.approx(0.02)
    with pytest.raises(TrackingError, match=r"moved by 6.0 cm, which may move by 5.0 cm"):
        plan.moved(0, 1, place + np.array([0.06, 0, 0]))
    with pytest.raises(TrackingError, match="may move"):
        plan.moved(0, 0, plan.stances[0][0].place + 0.01)


def test_compiled_queries_agree(trot):
    foot = np.empty(3)
    for t in np.arange(0.5, trot.end_s + 1, 0.031):
        for leg in range(4):
            k = trot.index(leg, t)
            assert stance_at(trot.table, leg, t) == (-1 if k is None else k)
            foot_at(trot.table, leg, t, foot)
            if k is not None:
                assert (foot == trot.stances[leg][k].place).all()
            else:
                a, b = trot.last(leg, t).place, trot.next(leg, t).place
                assert np.allclose(foot, a + trot.swing_phase(leg, t) * (b - a))


def test_a_gait_walks_a_plan_on(anymal):
    timing = GaitTiming.trot_at(0.3)
    plan = ContactPlan(standing(anymal))
    place_of = lambda leg, t: (anymal.stance[leg] * [1, 1, 0] + np.array([0.3 * t, 0, 0]), UP)  # noqa: E731
    on = walked_on(plan, timing, place_of, start_s=0.5, until_s=2.0)
    assert all(row[-1].begin_s > 2.0 for row in on.stances)
    further = walked_on(on, timing, place_of, start_s=0.5, until_s=4.0)
    for t in np.arange(0.0, 4.0, 0.013):
        if t < 2.0:
            assert (further.standing(t) == on.standing(t)).all()
        assert further.standing(t).sum() in (2, 4)
    short = further.since(3.0)
    assert len(short.stances[0]) < len(further.stances[0])
    assert (short.standing(3.1) == further.standing(3.1)).all()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda rows: rows[:3], "3 legs"),
        (lambda rows: [[], *rows[1:]], "FL never stands"),
        (lambda rows: [[Stance(0, 1, rows[0][0].place, UP), Stance(0.9, 2, rows[0][0].place, UP)], *rows[1:]], "order"),
        (lambda rows: [[Stance(2, 3, rows[0][0].place, UP), Stance(0, 1, rows[0][0].place, UP)], *rows[1:]], "order"),
        (lambda rows: [[Stance(1, 1, rows[0][0].place, UP)], *rows[1:]], "end after its begin"),
        (lambda rows: [[Stance(float("nan"), 1, rows[0][0].place, UP)], *rows[1:]], "end after its begin"),
        (lambda rows: [[Stance(0, 1, np.full(3, np.nan), UP)], *rows[1:]], "finite"),
        (lambda rows: [[Stance(0, 1, rows[0][0].place, np.zeros(3))], *rows[1:]], "points up"),
        (lambda rows: [[Stance(0, 1, rows[0][0].place, -UP)], *rows[1:]], "points up"),
        (lambda rows: [[Stance(0, 1, rows[0][0].place, UP, -1.0)], *rows[1:]], "movable"),
    ],
)
def test_a_plan_that_cannot_be_walked_is_refused_in_one_line(anymal, change, says):
    with pytest.raises(TrackingError, match=says) as error:
        ContactPlan(change(standing(anymal)))
    assert "\n" not in str(error.value)
    assert isinstance(error.value, LegtoolError)


@pytest.mark.parametrize("way", [(0.9, 0, 0), (0, -1.7, 0), (0.1, 0, -1.1), (0.4, 0, 0.9)])
def test_a_foothold_out_of_reach_is_refused(anymal, way):
    footholds = stones(anymal, 3, np.random.default_rng(2), rise=0.0)
    footholds[1][2:] += np.array(way)
    with pytest.raises(TrackingError, match=r"stance [12] at .* is out of reach by \d+ cm"):
        plan_from_gait(GaitTiming.trot(), footholds, start_s=0.0, robot=anymal)


@pytest.mark.parametrize(
    ("leg", "way", "says"),
    [
        (0, (0.0, -0.62, 0.0), "FL stands -2 cm left of FR, expected 6 cm"),
        (3, (0.0, 0.58, 0.0), "RL stands 2 cm left of RR, expected 6 cm"),
        (2, (0.7, 0.0, 0.0), "FL stands 2 cm ahead of RL, expected 6 cm"),
    ],
)
def test_feet_that_cross_are_refused(anymal, leg, way, says):
    plan = standing(anymal)
    rows = [list(row) for row in plan]
    old = rows[leg][0]
    rows[leg] = [replace(old, end_s=1.0), replace(old, begin_s=1.4, end_s=INF, place=old.place + np.array(way))]
    with pytest.raises(TrackingError, match=f"{LEGS[leg]}, stance 1 at .* crosses feet: {says}") as error:
        ContactPlan(rows, robot=anymal)
    assert "\n" not in str(error.value)
    ContactPlan(rows)


def test_a_foothold_that_joints_do_not_reach_is_refused(anymal):
    limits = anymal.joint_limits.copy()
    limits[:, 0] = [(-0.1, 0.1)] * 4
    stiff = replace(anymal, joint_limits=limits)
    rows = [list(row) for row in standing(anymal)]
    for leg, side in ((0, 1.0), (1, -1.0)):
        old = rows[leg][0]
        wide = replace(old, begin_s=1.4, end_s=INF, place=old.place + np.array([0.0, 0.15 * side, 0.0]))
        rows[leg] = [replace(old, end_s=1.0), wide]
    ContactPlan(rows, robot=anymal)
    with pytest.raises(TrackingError, match=r"stance 1 at .* turns F[LR] hip beyond its limit by 0\.\d+ rad") as error:
        ContactPlan(rows, robot=stiff)
    assert "\n" not in str(error.value)


def test_stones_within_reach_are_taken_for_every_robot(bodies):
    for robot, _, _ in bodies.values():
        scale = (robot.thigh_length[0] + robot.shank_length[0]) / 0.6125
        for seed in range(10):
            rng = np.random.default_rng(seed)
            footholds = stones(robot, 6, rng, stride=0.4 * scale, rise=0.1 * scale, most=0.2 * scale)
            for timing in (GaitTiming.trot(), GaitTiming.crawl()):
                plan_from_gait(timing, footholds, start_s=0.0, robot=robot)


@pytest.mark.parametrize("settings", [{"groups": ((0, 3), (1,))}, {"swing_s": 0.0}, {"full_stance_s": float("nan")}])
def test_gaits_that_do_not_walk_are_refused(settings):
    with pytest.raises(TrackingError, match="gait"):
        GaitTiming(**settings)
    with pytest.raises(TrackingError, match="speed"):
        GaitTiming.trot_at(float("nan"))
