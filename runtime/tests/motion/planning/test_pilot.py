"""A pilot on a robot's clock: it carries plans through, and backs off for a run-up instead of waiting for ever."""

import numpy as np
import pytest
import walker
from walker import standing, strip

from legtool_runtime.errors import MapError
from legtool_runtime.motion.planning.pilot import Pilot
from legtool_runtime.motion.planning.planner import Goal, Planner, PlannerSettings, planar_commands

REVERSING = planar_commands(np.arange(-3, 11) * 0.1, [0.0], [0.0])
FAR = Goal(5.0, 0.0)


def pilot(commands=REVERSING, **how):
    settings = PlannerSettings(deadline_s=None, **walker.BARE)
    return Pilot(Planner(walker.model(), walker.ROBOT, commands=commands, settings=settings), **how)


def ask(p, *, x=0.0, time_s=0.0, steps=0, costmap=None, state=None, goal=FAR):
    costmap = strip((0.45, 3.0)) if costmap is None else costmap  # a chasm that nothing crosses
    place = {"position": [x, 0.0, 0.36], "rotation": np.eye(3)}
    return p.command(state or standing(), costmap, **place, goal=goal, time_s=time_s, steps=steps)


def test_a_robot_without_headway_backs_off_and_then_comes_again():
    p = pilot(run_up_m=0.6)
    for time_s in (0.0, 1.0, 2.0):
        ask(p, time_s=time_s)
        assert not p.backing_off
    assert ask(p, time_s=2.1)[0] < 0 and p.backing_off
    assert ask(p, x=-0.3, time_s=3.0)[0] < 0 and p.backing_off
    assert ask(p, x=-0.61, time_s=4.0)[0] > 0 and not p.backing_off
    assert ask(p, x=-0.3, time_s=6.5)[0] > 0 and not p.backing_off  # headway: its patience begins anew
    ask(p, x=-0.3, time_s=8.6)
    assert p.backing_off


def test_fast_commands_are_kept_for_run_ups_until_the_obstacle_is_left_behind():
    p, far = pilot(cruise_speed=0.4, run_up_m=0.6), Goal(50.0, 0.0)
    fast = standing(speed=0.4)
    assert ask(p, costmap=strip(), state=fast, goal=far)[0] == pytest.approx(0.4)
    ask(p, time_s=2.1, goal=far)
    assert p.backing_off
    for x, fastest in ((-0.61, 0.9), (0.3, 0.9), (0.59, 0.9), (0.7, 0.4), (0.3, 0.4)):
        command = ask(p, x=x, time_s=3.0, costmap=strip(), state=fast, goal=far)
        assert command[0] == pytest.approx(fastest) or x == 0.3
    slow = Goal(50.0, 0.0, max_speed=0.2)
    assert ask(p, x=0.7, time_s=4.0, costmap=strip(), state=standing(speed=0.2), goal=slow)[0] == pytest.approx(0.2)


def test_after_a_run_up_it_plans_boldly_until_the_obstacle_is_left_behind():
    p, asked = pilot(run_up_m=0.6), []
    plan = p.planner.plan
    p.planner.plan = lambda *state, **how: asked.append(how["bold"]) or plan(*state, **how)
    for x, time_s in ((0.0, 0.0), (0.0, 2.1), (-0.3, 3.0), (-0.61, 4.0), (0.3, 5.0), (0.7, 6.0)):
        ask(p, x=x, time_s=time_s, costmap=strip() if x == 0.7 else None)
    assert asked == [False, False, False, True, True, False]


def test_each_further_run_up_for_one_place_is_longer():
    p, x, time_s, backed = pilot(run_up_m=0.6), 0.0, 0.0, []
    for _ in range(3):
        while not p.backing_off:
            ask(p, x=x, time_s=time_s)
            time_s += 0.5
        start = x
        while p.backing_off:
            x -= 0.05
            ask(p, x=x, time_s=time_s)
            time_s += 0.1
        backed.append(start - x)
        x = 0.0
    assert backed[0] == pytest.approx(0.6, abs=0.06)
    assert np.diff(backed) == pytest.approx(0.15, abs=0.06)


def test_what_does_not_go_at_cruise_speed_is_done_at_any():
    fast, ahead = standing(speed=0.9), strip((0.2, 0.6))
    slow = pilot(cruise_speed=0.4)
    command = ask(slow, state=fast, costmap=ahead)
    np.testing.assert_array_equal(command, ask(pilot(), state=fast, costmap=ahead))
    assert command[0] > 0.4 and slow.plan.status == "horizon"


def test_backing_off_ends_though_the_way_back_is_blocked():
    p = pilot()
    for time_s in (0.0, 2.1):
        ask(p, time_s=time_s)
    assert p.backing_off
    ask(p, time_s=8.2)
    assert not p.backing_off


@pytest.mark.parametrize(
    ("how", "goal"),
    [
        ({"commands": None}, FAR),  # no command goes backwards
        ({}, Goal(5.0, 0.0, steered=True)),
        ({}, Goal(0.05, 0.0)),  # arrived
    ],
)
def test_some_never_back_off(how, goal):
    p = pilot(**how)
    for time_s in np.arange(0.0, 10.0, 0.5):
        ask(p, time_s=time_s, goal=goal)
        assert not p.backing_off


def test_another_goal_calls_a_robot_back_from_backing_off():
    p = pilot()
    for time_s in (0.0, 2.1):
        ask(p, time_s=time_s)
    assert p.backing_off
    ask(p, time_s=2.5, goal=Goal(0.0, 4.0))
    assert not p.backing_off


def test_where_no_plan_is_whole_the_last_whole_one_is_carried_through():
    p, nowhere = pilot(), strip((-2.0, 6.0))
    ask(p, costmap=strip(), steps=3)
    whole = p.plan
    assert whole.status == "horizon"
    for made in range(1, 5):
        np.testing.assert_array_equal(ask(p, costmap=nowhere, steps=3 + made), whole.commands[made])
        assert p.plan.status == "blocked"
    assert not ask(p, costmap=nowhere, steps=8).any()


def test_within_a_step_that_has_a_whole_plan_an_earlier_steps_plan_is_what_is_gone_on_with():
    p = pilot()
    ask(p, costmap=strip(), steps=3)
    first = p.plan
    ask(p, costmap=strip(), steps=4, state=standing(1, 0.3))
    np.testing.assert_array_equal(ask(p, costmap=strip((-2.0, 6.0)), steps=4), first.commands[1])


def test_what_cannot_be_planned_from_is_raised_at_the_start_alone():
    with pytest.raises(MapError, match="is not on it"):
        ask(pilot(), x=50.0)
    p = pilot()
    ask(p)
    assert not ask(p, x=50.0).any() and p.plan.status == "refused"
