import math
from dataclasses import replace

import numpy as np
import pytest
from stones_and_bodies import BODIES

from legtool_runtime.errors import TrackingError
from legtool_runtime.foothold import Criteria
from legtool_runtime.foothold.heightmap import nearest_safe
from legtool_runtime.foothold.selection import FootholdSelector
from legtool_runtime.rotations import place
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.foothold_choice import (
    FootholdChooser,
    Place,
    Trunk,
    any_place,
    crawl_nominal,
    ground_normal,
    safe_places,
    trot_nominal,
)
from legtool_runtime.tracking.gaits import GaitTiming
from legtool_runtime.tracking.pendulum import Planar, about_line, about_point, feedback, frequency

HYQ = BODIES["hyq"][0]
UP = np.array([0, 0, 1.0])
DIAGONAL = HYQ.stance[[1, 2]] * [1, 1, 0]


def level(size=201):
    return HeightMap(np.zeros((size, size), np.float32), 0.02, np.zeros(2))


def trunk(x=0.0, y=0.0, vx=0.0, vy=0.0):
    return Trunk(np.array([x, y, 0.64]), np.array([vx, vy, 0.0]), 0.0, 0.64)


def test_the_pendulum_is_the_one_of_the_equations_of_motion():
    omega, line = frequency(0.6), np.array([[0.3, -0.2], [-0.3, 0.2]])
    now = Planar(np.array([0.02, 0.01]), np.array([0.3, -0.1]))
    normal = np.array([-0.4, -0.6]) / np.hypot(0.4, 0.6)
    s, v = float((now.position - line[0]) @ normal), float(now.velocity @ normal)
    for _ in range(30000):
        v += 1e-5 * omega**2 * s
        s += 1e-5 * v
    then = about_line(now, *line, omega=omega, wanted=np.zeros(2), time_s=0.3)
    assert (then.position - line[0]) @ normal == pytest.approx(s, abs=1e-4)
    assert then.velocity @ normal == pytest.approx(v, abs=1e-3)
    point = about_point(now, np.zeros(2), omega=omega, time_s=0.3)
    growth = point.diverging(omega) / now.diverging(omega)
    assert np.allclose(growth, np.exp(omega * 0.3))


def test_a_standing_robot_steps_where_it_stands():
    nominal, _, _ = trot_nominal(
        HYQ, 0, trunk(), diagonal=DIAGONAL, command=(0, 0, 0), timing=GaitTiming.trot_at(0.0), left_s=0.35
    )
    assert np.allclose(nominal, HYQ.stance[0, :2], atol=1e-9)


def test_a_trunk_that_runs_away_is_stepped_after():
    timing, omega = GaitTiming.trot_at(0.2), frequency(0.64)
    at = lambda t: trot_nominal(  # noqa: E731
        HYQ, 0, t, diagonal=DIAGONAL, command=(0, 0, 0), timing=timing, left_s=timing.swing_s
    )[0]
    sideways = at(trunk(vy=0.2)) - at(trunk())
    assert sideways[1] > 0.2 * feedback(omega, timing.swing_s)
    assert at(trunk(x=0.02))[0] > at(trunk())[0] + 0.02


@pytest.mark.parametrize("vy", [0.0, 0.15])
def test_pendulum_steps_with_this_feedback_stay_up(vy):
    """Steps of the pendulum itself: sideways errors die out, and the commanded velocity is kept."""
    timing, command = GaitTiming.trot_at(0.3), (0.3, 0.0, 0.0)
    omega = frequency(0.64)
    com, velocity, before = np.zeros(2), np.array([0.3, vy]), 0.0
    feet = HYQ.stance[:, :2].copy()
    for step in range(40):
        swing, stand = ((0, 3), (1, 2)) if step % 2 == 0 else ((1, 2), (0, 3))
        state = Trunk(np.array([*com, 0.64]), np.array([*velocity, 0.0]), 0.0, 0.64)
        standing = np.column_stack([feet[list(stand)], [0, 0]])
        for leg in swing:
            feet[leg], _, _ = trot_nominal(
                HYQ, leg, state, diagonal=standing, command=command, timing=timing, left_s=timing.swing_s
            )
        moved = about_line(
            Planar(com, velocity), *standing[:, :2], omega=omega, wanted=np.array(command[:2]), time_s=timing.swing_s
        )
        com, velocity = moved.position + timing.full_stance_s * moved.velocity, moved.velocity
        before = com[1] if step == 29 else before
        assert abs(com[1]) < 0.25
    assert abs(com[1] - before) < 0.02
    assert com[0] / (40 * timing.step_s) == pytest.approx(0.3, abs=0.1)


def test_a_crawl_answers_the_divergence():
    timing = GaitTiming.crawl_online()
    plain, place, yaw = crawl_nominal(HYQ, 1, implied=(1.0, 2.0, 0.0), command=(0.1, 0, 0), timing=timing, left_s=0.3)
    moved, _, _ = crawl_nominal(
        HYQ, 1, implied=(1.0, 2.0, 0.0), command=(0.1, 0, 0), timing=timing, left_s=0.3, divergence=(0.02, -0.05)
    )
    assert np.allclose(moved - plain, [0.014, -0.035])
    assert place[0] == pytest.approx(1.03)
    assert plain[0] == pytest.approx(1.03 + 0.3735 + 0.05 * timing.stance_s)
    assert yaw == 0.0


def chooser(select, timing=None):
    return FootholdChooser(HYQ, GaitTiming.trot_at(0.2) if timing is None else timing, select)


def test_footholds_are_chosen_again_at_three_phases_and_only_near_on_one_level():
    # The second answer is to the look ahead, at a foothold a cycle later.
    offsets = iter([0.0, 0.0, 0.10, 0.001, 0.05])
    heights = iter([0.0, 0.0, 0.0, 0.0, 0.05])
    base = HYQ.stance[0] * [1, 1, 0]
    choose = chooser(lambda wish: Place(base + np.array([next(offsets), 0, next(heights)]), UP))
    stood = Place(base, UP)
    first = choose.lift_off(0, trunk(), stood=stood, command=(0.2, 0, 0), diagonal=DIAGONAL)
    assert first.by == "safe"
    asked = lambda phase, aimed: choose.again(  # noqa: E731
        0, trunk(), phase=phase, aimed=aimed, command=(0.2, 0, 0), diagonal=DIAGONAL
    )
    assert asked(0.1, first.place) is None
    second = asked(0.21, first.place)
    assert second.place.point[0] == pytest.approx(base[0] + 0.10)
    assert asked(0.3, second.place) is None  # no phase of choice
    assert asked(0.41, Place(base, UP)) is None  # 1 mm away
    assert asked(0.61, Place(base, UP)) is None  # on another level
    assert asked(0.9, Place(base, UP)) is None


def test_where_nothing_is_safe_the_robot_steps_in_place_and_then_back():
    stood = Place(HYQ.stance[0] * [1, 1, 0], UP)
    still_only = chooser(lambda wish: stood if wish.twist[0] == 0 else None)
    choice = still_only.lift_off(0, trunk(), stood=stood, command=(0.4, 0, 0), diagonal=DIAGONAL)
    assert choice.by == "in_place"
    never = chooser(lambda wish: None)
    choice = never.lift_off(0, trunk(), stood=stood, command=(0.4, 0, 0), diagonal=DIAGONAL)
    assert choice.by == "back"
    assert choice.place is stood
    assert never.pace((0.4, 0, 0), 0.0) == 0.0
    never.select = any_place(None)
    never.lift_off(0, trunk(), stood=stood, command=(0.4, 0, 0), diagonal=DIAGONAL)
    assert never.pace((0.4, 0, 0), 0.0) == 1.0


@pytest.mark.parametrize("ends", [False, True])
@pytest.mark.parametrize(("behind_m", "pace"), [(-0.3, 1.0), (0.0, 1.0), (0.12, 1.0), (0.16, 0.5), (0.25, 0.0)])
def test_feet_that_stay_behind_their_nominal_footholds_slow_the_trunk_down(behind_m, pace, ends):
    lags = chooser(lambda wish: Place(np.array([*(wish.nominal - [0.0, behind_m]), 0.0]), UP))
    # A pit, or ground that is only not safe: there the trunk goes on at a half.
    lags.elevation = HeightMap(np.full((200, 200), -1.0 if ends else 0.1), 0.02, np.zeros(2))
    one = trunk()._replace(yaw=math.pi / 2)
    for leg in (0, 3):
        lags.lift_off(leg, one, stood=Place(np.zeros(3), UP), command=(0.2, 0, 0), diagonal=DIAGONAL)
    assert lags.pace((0.2, 0, 0.1), math.pi / 2) == pytest.approx(pace if ends else max(pace, 0.5), abs=1e-6)
    assert lags.pace((0.0, 0, 0.1), math.pi / 2) == 1.0  # nothing is to be slowed down


def test_the_criteria_choose_safe_ground_beside_a_gap():
    elevation = level()
    heights = elevation.heights.copy()
    x = (np.arange(201) - 100) * 0.02
    heights[(x > 0.40) & (x < 0.50)] = -1.0
    gap = HeightMap(heights, 0.02, np.zeros(2))
    selector = FootholdSelector(Criteria(HYQ))
    choose = chooser(safe_places(selector, gap))
    stood = Place(HYQ.stance[0] * [1, 1, 0], UP)
    choice = choose.lift_off(0, trunk(x=0.05, vx=0.2), stood=stood, command=(0.2, 0, 0), diagonal=DIAGONAL)
    assert choice.by in ("safe", "in_place")
    assert choice.place.point[2] == 0.0
    assert not 0.39 < choice.place.point[0] < 0.51
    flat = chooser(safe_places(selector, elevation))
    same = flat.lift_off(0, trunk(), stood=stood, command=(0.2, 0, 0), diagonal=DIAGONAL)
    assert np.allclose(same.place.point[:2], same.nominal)


def test_the_criteria_judge_the_legs_below_the_trunk_as_planned_at_touchdown():
    # Nose up, the front thighs have no range left for a foot right below the hip; level, they have.
    limits = HYQ.joint_limits.copy()
    limits[:2, 1] = -0.8727, 1.2217  # the preset's
    elevation, selector, asked = level(), FootholdSelector(Criteria(replace(HYQ, joint_limits=limits))), []

    def watched(wish):
        asked.append(wish)
        return safe_places(selector, elevation)(wish)

    stood = Place(HYQ.stance[0] * [1, 1, 0], UP)
    choose = chooser(watched)
    ways = []
    for pitch in (0.0, -0.3):
        # The same hip height for both.
        height = 0.48 - float(place(HYQ.hips[0], 0.02, pitch, 0.0)[2])
        state = trunk()._replace(height=height, roll=0.02, pitch=pitch)
        choice = choose.lift_off(0, state, stood=stood, command=(0.2, 0, 0), diagonal=DIAGONAL)
        ways.append(float(np.hypot(*(choice.place.point[:2] - choice.nominal))))
        assert (asked[-1].roll, asked[-1].pitch) == (0.02, pitch)
        assert choice.by == "safe"
    assert ways[0] < 0.01 < 0.03 < ways[1]


def test_distances_to_the_side_count_more_and_far_ones_are_refused():
    safe = np.zeros((33, 33), np.bool_)
    safe[16, 16 + 4], safe[16 + 7, 16] = True, True
    assert nearest_safe(safe, (1, 0)) == (16, 20)
    assert nearest_safe(safe, (1, 0), sideways=2.5) == (23, 16)
    safe[23, 16] = False
    assert nearest_safe(safe, (1, 0), sideways=2.5, most_sideways_m=0.08) == (16, 20)
    assert nearest_safe(safe, (1, 0), sideways=2.5, most_sideways_m=0.07) is None


def test_normals_are_those_of_slopes_and_straight_up_beside_edges():
    i = (np.arange(101) - 50) * 0.02
    ramp = HeightMap(np.repeat(0.25 * i[:, None], 101, axis=1).astype(np.float32), 0.02, np.zeros(2))
    assert np.allclose(ground_normal(ramp, 0.1, 0.1), np.array([-0.25, 0, 1]) / np.hypot(0.25, 1), atol=1e-6)
    step = HeightMap(np.repeat(np.where(i > 0.1, 0.1, 0.0)[:, None], 101, axis=1).astype(np.float32), 0.02, np.zeros(2))
    assert (ground_normal(step, 0.1, 0.0) == UP).all()
    assert (ground_normal(step, 99.0, 0.0) == UP).all()
    assert (ground_normal(None, 0.0, 0.0) == UP).all()


def test_a_trunk_that_is_not_finite_is_refused_at_lift_off_and_ignored_later():
    choose = chooser(any_place(None))
    with pytest.raises(TrackingError, match="foothold choice"):
        choose.lift_off(0, trunk(x=np.nan), stood=Place(np.zeros(3), UP), command=(0, 0, 0), diagonal=DIAGONAL)
    aimed = Place(np.zeros(3), UP)
    assert choose.again(0, trunk(x=np.nan), phase=0.5, aimed=aimed, command=(0, 0, 0), diagonal=DIAGONAL) is None
