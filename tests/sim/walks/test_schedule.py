from __future__ import annotations

import numpy as np

from legtool.configs.sweep import SweepSettings
from legtool.sim.walks.schedule import SETTLE_S, all_pairs, random_schedule, sweep_schedule

SETTINGS = SweepSettings(episodes=120, seed=4)


def test_all_pairs_holds_each_ordered_pair_once() -> None:
    for count in (1, 2, 5, 14):
        cycle = all_pairs(count)
        pairs = set(zip(cycle.tolist(), np.roll(cycle, -1).tolist(), strict=True))
        assert len(cycle) == count**2 and len(pairs) == count**2


def test_a_sweep_sees_every_change_of_each_axis_alone() -> None:
    settings = SETTINGS.replace(stop_share=0.0)
    for axis, grid in enumerate((settings.vx, settings.vy, settings.yaw_rate)):
        seen = set()
        for index in range(120):
            commands = sweep_schedule(settings, index).commands[1:]
            if not np.delete(commands, axis, axis=1).any():
                seen |= set(zip(commands[:-1, axis].tolist(), commands[1:, axis].tolist(), strict=True))
        assert seen >= {(a, b) for a in grid for b in grid}


def test_some_episodes_move_along_all_axes_at_once() -> None:
    commands = np.concatenate([sweep_schedule(SETTINGS, index).commands for index in range(12)])
    assert ((commands != 0).sum(axis=1) == 3).mean() > 0.15


def test_episodes_begin_standing_and_last_as_long_as_set() -> None:
    for index in range(6):
        schedule = sweep_schedule(SETTINGS, index)
        assert not schedule.commands[0].any() and schedule.times_s[1] == SETTLE_S
        assert (np.diff(schedule.times_s) > 0.1).all()
        assert schedule.times_s[-1] < schedule.duration_s == SETTINGS.episode_s


def test_stops_are_long_enough_to_stand_and_walking_goes_on_as_before() -> None:
    schedule = sweep_schedule(SETTINGS.replace(stop_share=1.0), 0)
    stops = np.flatnonzero(~schedule.commands[1:-1].any(axis=1)) + 1
    between = [k for k in stops if (schedule.commands[k - 1] == schedule.commands[k + 1]).all()]
    assert len(between) >= 5


def test_a_schedule_is_a_function_of_settings_seed_and_number() -> None:
    first, again = sweep_schedule(SETTINGS, 7), sweep_schedule(SETTINGS, 7)
    np.testing.assert_array_equal(first.commands, again.commands)
    np.testing.assert_array_equal(first.times_s, again.times_s)
    assert not np.array_equal(first.commands, sweep_schedule(SETTINGS, 6).commands)
    assert not np.array_equal(first.times_s, sweep_schedule(SETTINGS.replace(seed=5), 7).times_s)


def test_random_commands_stay_in_their_box() -> None:
    schedule = random_schedule(120.0, seed=0)
    assert (schedule.commands >= [-0.3, -0.3, -0.6]).all() and (schedule.commands <= [1.0, 0.3, 0.6]).all()
    assert schedule.times_s[0] == 0 and schedule.times_s[-1] < 120.0
