"""The monitor: each event by what is measured, what it makes the robot do, and the same again from a log."""

import copy

import numpy as np
import pytest

from legtool_runtime.errors import PlannerError
from legtool_runtime.search.monitor import (
    COLUMNS,
    NAMES,
    Event,
    MonitorSettings,
    MonitorState,
    Phase,
    Reaction,
    Reading,
    watch,
)

TICK_S = 0.005
FEET = np.array([[0.36, 0.3, 0.0], [0.36, -0.3, 0.0], [-0.36, 0.3, 0.0], [-0.36, -0.3, 0.0]])


def calm(**changes):
    """A robot in the middle of a plan: all feet stand where they should, and other steps are ahead."""
    values = {
        "time_s": 0.0, "clock_s": 0.0, "lean": np.zeros(2), "turning": np.zeros(3), "joint_speeds": np.zeros(12),
        "torques": np.zeros(12), "off": np.zeros(3), "capture": np.zeros(2), "speed": 0.0,
        "position": np.array([0.0, 0.0, 0.55]),
        "loads": np.full(4, 0.25), "stands": np.ones(4), "late": np.zeros(4), "phases": np.zeros(4), "feet": FEET,
        "places": FEET, "margins": np.full(4, 0.1), "seen": np.full(4, np.nan), "shift_s": 0.0, "ahead": 6.0,
        "final": 0.0, "age_s": 0.05,
    }  # fmt: skip
    return Reading(**{**values, **changes})


def at(leg, value, other=0.0):
    out = np.full(4, other)
    out[leg] = value
    return out


def flying(leg, phase, load=0.0, **changes):
    loads, stands = np.full(4, 1 / 3), np.ones(4)
    loads[leg], stands[leg] = load, 0.0
    return calm(stands=stands, loads=loads, phases=at(leg, phase), **changes)


def run(readings, state=None, settings=None, start_s=0.0):
    """Every reading a tick after the last; the states and verdicts."""
    state, out = state or MonitorState.begin(), []
    for k, reading in enumerate(readings):
        state, verdict = watch(state, reading._replace(time_s=start_s + k * TICK_S), settings)
        out.append(verdict)
    return state, out


def told(readings, **others):
    """Every event with the reading at which it begins, and what it asks for."""
    _, verdicts = run(readings, **others)
    return [(k, event, v.reaction) for k, v in enumerate(verdicts) for event in v.events]


def test_nothing_is_told_of_a_walk_that_goes_as_it_should():
    walk = [calm()] * 20 + [flying(0, p) for p in np.linspace(0.02, 0.98, 60)] + [calm()] * 20
    assert told(walk) == []


@pytest.mark.parametrize(
    ("change", "event", "after_s", "reaction"),
    [
        ({"lean": np.array([0.0, -0.26])}, Event.TILT, 0.05, Reaction.HOLD),
        ({"lean": np.array([0.46, 0.0])}, Event.TILT, 0.0, Reaction.HOLD),
        ({"turning": np.array([0.0, 0.0, 3.1])}, Event.RATES, 0.03, Reaction.HOLD),
        ({"joint_speeds": np.eye(12)[4] * -20.1}, Event.RATES, 0.03, Reaction.HOLD),
        ({"torques": np.eye(12)[7] * -0.99}, Event.TORQUE, 0.10, Reaction.HOLD),
        ({"off": np.array([0.09, -0.09, 0.0])}, Event.TORSO_OFF, 0.02, Reaction.REPLAN),
        ({"off": np.array([0.0, 0.0, -0.09])}, Event.TORSO_OFF, 0.02, Reaction.REPLAN),
        ({"late": at(2, 1.0), "stands": at(2, 0.0, 1.0), "phases": at(2, 1.1)}, Event.LATE, 0.06, Reaction.GO_ON),
        ({"shift_s": 0.02}, Event.LATE_PLAN, 0.0, Reaction.GO_ON),
        ({"ahead": 0.0}, Event.FINISHED, 0.05, Reaction.REPLAN),
    ],
)
def test_an_event_is_told_once_when_it_has_lasted(change, event, after_s, reaction):
    first, lasts = 10, round(after_s / TICK_S)
    assert told([calm()] * first + [calm(**change)] * 40) == [(first + lasts, event, reaction)]
    assert told([calm()] * first + [calm(**change)] * lasts + [calm()] * 5) == []


def test_it_is_told_again_when_it_has_ceased_and_come_back():
    tilted, level = [calm(off=np.array([0.2, 0.0, 0.0]))] * 10, [calm()] * 5
    assert [e for _, e, _ in told(level + tilted + level + tilted)] == [Event.TORSO_OFF] * 2


def test_a_foot_that_landed_off_its_place_is_told_of_only_near_an_edge():
    beside = FEET + at(1, 0.05)[:, None] * [1.0, 0.0, 0.0]
    swing = [flying(1, p) for p in (0.5, 0.9)]
    landed = calm(feet=beside, places=beside, margins=at(1, 0.005, 0.1))
    after = lambda r: told([calm(), *swing, *[r] * 30])  # noqa: E731
    assert after(landed) == [(12, Event.FOOT_OFF, Reaction.REPLAN)]  # when it has borne load for 50 ms
    assert after(landed._replace(margins=np.full(4, 0.02))) == []
    assert after(landed._replace(margins=np.full(4, np.nan))) == []
    near = FEET + at(1, 0.03)[:, None] * [1.0, 0.0, 0.0]
    assert after(landed._replace(feet=near, places=near)) == []


def test_early_contacts_are_told_of_by_load_and_by_landing():
    assert told([calm(), *[flying(3, 0.5, load=0.1)] * 4]) == [(1, Event.EARLY, Reaction.REPLAN)]
    assert told([calm(), flying(3, 0.6), flying(3, 0.7), calm()]) == [(3, Event.EARLY, Reaction.REPLAN)]
    # The load that a foot sheds when it lifts off, and a touchdown in time, are none.
    assert told([calm(), flying(3, 0.05, load=0.1), flying(3, 0.6), flying(3, 0.97, load=0.1), calm()]) == []


def test_a_foot_that_finds_no_ground_stops_the_robot_after_some_time():
    lost = calm(late=at(2, 1.0), stands=at(2, 0.0, 1.0), phases=at(2, 1.2), loads=at(2, 0.0, 0.3))
    got = told([calm()] + [lost] * 80)
    assert [(e, r) for _, e, r in got] == [(Event.LATE, Reaction.GO_ON), (Event.LATE, Reaction.HOLD)]
    assert (got[1][0] - 1) * TICK_S == pytest.approx(0.3)


def test_a_loaded_foot_that_moves_from_where_it_came_to_stand_slips():
    swing, landed = [flying(0, 0.9)], [calm()] * 12
    slid = calm(feet=FEET + at(0, 0.035)[:, None] * [1.0, 0.0, 0.0])
    got = told(swing + landed + [slid] * 10)
    assert [(e, r) for _, e, r in got] == [(Event.SLIP, Reaction.HOLD)]
    assert told(swing + landed + [slid._replace(loads=at(0, 0.01, 0.33))] * 10) == []
    # Noise about the limit is not another slip, and another three centimetres are.
    back = slid._replace(feet=FEET + at(0, 0.027)[:, None] * [1.0, 0.0, 0.0])
    noisy = ([slid] * 8 + [back] * 8) * 6
    assert told(swing + landed + noisy) == got
    farther = slid._replace(feet=FEET + at(0, 0.07)[:, None] * [1.0, 0.0, 0.0])
    assert len(told(swing + landed + noisy + [farther] * 10)) == 2
    # What moves before it bears load, as where a touch was told of too soon, does not slip.
    high = slid._replace(loads=at(0, 0.0, 0.33))
    assert told(swing + [high] * 4 + [calm()] * 40) == []
    _, verdicts = run(swing + landed + [slid] * 10)
    assert any("FL" in v.reason for v in verdicts)


def test_a_place_is_lost_after_three_frames_without_a_candidate():
    gone, there = at(1, 0.0, 1.0), np.ones(4)
    between = flying(1, 0.3)
    frames = lambda *seen: [r for s in seen for r in (flying(1, 0.3, seen=s), between, between)]  # noqa: E731
    assert told([calm(), *frames(gone, gone, there, gone, gone)]) == []
    assert told([calm(), *frames(gone, gone, gone, gone)]) == [(7, Event.REGION_LOST, Reaction.REPLAN)]


def test_a_robot_is_starved_at_the_last_but_one_full_stance_unless_it_is_to_stop_there():
    late = calm(ahead=1.0, age_s=0.6)
    assert told([calm(), late, late]) == [(1, Event.STARVED, Reaction.GO_ON)]
    assert told([calm(), late._replace(final=1.0)]) == []
    assert told([calm(), late._replace(ahead=2.0)]) == []
    assert told([calm(), late._replace(age_s=0.4)]) == []


def test_a_stopped_robot_goes_on_when_its_torso_rests_over_its_feet():
    fall, stand = [calm(lean=np.array([0.5, 0.0]))], [calm(speed=0.4)] * 5 + [calm()] * 40
    state, verdicts = run([calm(), *fall, *stand])
    phases = [v.phase for v in verdicts]
    assert phases[1] == Phase.HOLDING and verdicts[1].reaction == Reaction.HOLD and verdicts[1].reason
    resumed = [k for k, v in enumerate(verdicts) if v.resumed]
    assert len(resumed) == 1 and 7 <= resumed[0] <= 18
    assert verdicts[resumed[0]].reaction == Reaction.REPLAN and state.phase == Phase.WALKING


def test_a_robot_that_was_pushed_steps_on_until_it_is_caught():
    slips = calm(torques=np.eye(12)[0], capture=np.array([0.06, -0.06]))
    _, verdicts = run([calm()] + [slips] * 40)
    assert {v.phase for v in verdicts} == {Phase.WALKING}
    assert [v.reaction for v in verdicts if v.events] == [Reaction.REPLAN]
    _, verdicts = run([calm()] + [slips._replace(capture=np.array([0.06, 0.0]))] * 40)
    assert verdicts[-1].phase != Phase.WALKING or any(v.reaction == Reaction.HOLD for v in verdicts)


def test_a_stopped_robot_waits_for_feet_in_the_air_and_no_longer_than_it_may():
    fall, air = [calm(lean=np.array([0.5, 0.0]))], [flying(0, 0.5)] * 60
    _, verdicts = run([calm(), *fall, *air])
    assert all(v.phase == Phase.HOLDING for v in verdicts[1:])
    restless = [calm(speed=0.5)] * 140
    _, verdicts = run([calm(), *fall, *restless])
    at_last = next(k for k, v in enumerate(verdicts) if v.resumed)
    assert (at_last - 1) * TICK_S == pytest.approx(0.6, abs=0.02)


def test_after_three_stops_at_one_place_the_way_is_avoided_and_after_five_the_robot_stands_for_good():
    once = [calm(lean=np.array([0.5, 0.0]))] + [calm()] * 40
    _, verdicts = run(once * 6)
    stops = [v for v in verdicts if v.reaction >= Reaction.HOLD and Event.TILT in v.events]
    assert [v.avoid for v in stops[:5]] == [False, False, True, True, True]
    assert [v.phase for v in stops[:5]] == [Phase.HOLDING] * 4 + [Phase.STANDING]
    assert "stopped 5 times" in stops[4].reason and verdicts[-1].phase == Phase.STANDING
    assert verdicts[-1].reaction == Reaction.STAND
    far = [r._replace(position=np.array([0.5 * k, 0.0, 0.5])) for k in range(6) for r in once]
    _, verdicts = run(far)
    assert not any(v.avoid for v in verdicts) and verdicts[-1].phase == Phase.WALKING


def test_it_remembers_nothing_but_its_state():
    """From a copied state the same readings give the same verdicts, and an old state is not changed by later ones."""
    rng = np.random.default_rng(0)
    readings = [
        calm(
            lean=rng.normal(0, 0.1, 2), off=rng.normal(0, 0.05, 3), stands=(rng.random(4) > 0.2).astype(float),
            phases=rng.random(4), loads=0.3 * rng.random(4), seen=np.where(rng.random(4) < 0.3, 0.0, np.nan),
        )
        for _ in range(200)
    ]  # fmt: skip
    state, _ = run(readings[:100])
    kept = copy.deepcopy(state)
    _, first = run(readings[100:], state, start_s=0.5)
    for name, value in vars(kept).items():
        np.testing.assert_array_equal(getattr(state, name), value)
    _, again = run(readings[100:], kept, start_s=0.5)
    assert again == first and any(v.events for v in first)


def test_a_reading_comes_back_from_its_row():
    reading = flying(2, 0.4, seen=at(0, np.nan, 1.0), time_s=3.25)
    row = reading.row()
    assert row.shape == (COLUMNS,) == (len(NAMES),) and len(set(NAMES)) == COLUMNS
    for a, b in zip(Reading.of_row(row), reading, strict=True):
        np.testing.assert_array_equal(a, b)
    with pytest.raises(PlannerError, match="shape"):
        Reading.of_row(row[:-1])


def test_limits_go_with_the_robots_size(anymal, go2):
    big, small = MonitorSettings.of(anymal), MonitorSettings.of(go2)
    assert small.torso_xy < 0.75 * big.torso_xy and small.slip < big.slip and small.turning > big.turning
    assert big.torso_xy == pytest.approx(MonitorSettings().torso_xy, rel=0.02) and small.tilt == big.tilt


@pytest.mark.parametrize("change", [{"tilt": 0.0}, {"aborts": 0}, {"slip": float("nan")}, {"give_up": 2.5}])
def test_limits_that_cannot_be_used_are_refused(change):
    with pytest.raises(PlannerError, match="monitor"):
        MonitorSettings(**change)
