"""What the tracker does with what it measures; walks in MuJoCo are in ``tests/sim/tracking``."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from legtool_runtime.errors import TrackingError
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.dynamics import GRAVITY
from legtool_runtime.tracking.gaits import GaitTiming, plan_from_gait
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.reassign import Footholds
from legtool_runtime.tracking.settings import TrackerSettings
from legtool_runtime.tracking.tracker import MeasuredState, Tracker

DT = 0.0025


@pytest.fixture
def standing(tracked: TrackedRobot) -> MeasuredState:
    geometry = tracked.geometry
    angles, _ = geometry.joints(geometry.stance)
    position = np.array([0.0, 0.0, geometry.standing_height])
    forces = np.full(4, tracked.mass * GRAVITY / 4)
    return MeasuredState(position, np.array([1.0, 0.0, 0.0, 0.0]), angles, np.zeros(18), forces)


def make(tracked: TrackedRobot, *, steps: int = 1, stride: float = 0.05, start_s: float = 0.1) -> Tracker:
    places = np.add(
        tracked.geometry.stance, (0.0, 0.0, -tracked.geometry.foot_radius + tracked.geometry.standing_height)
    )
    footholds = [[np.add(place, (stride * k, 0.0, 0.0)) for k in range(steps + 1)] for place in places]
    return Tracker(tracked, plan_from_gait(GaitTiming.trot(), footholds, start_s=start_s))


def run(tracker: Tracker, state: MeasuredState, begin_s: float, seconds: float) -> float:
    """Ticks with one measurement; the time of the last."""
    ticks = round(seconds / DT)
    for tick in range(ticks):
        torques = tracker.step(state, begin_s + tick * DT)
        assert torques.shape == (12,) and np.isfinite(torques).all()
        assert (np.abs(torques.reshape(4, 3)) <= tracker.robot.torque_limit + 1e-9).all()
    return begin_s + (ticks - 1) * DT


def test_a_robot_that_stands_is_carried(tracked: TrackedRobot, standing: MeasuredState) -> None:
    tracker = make(tracked, start_s=5.0)
    run(tracker, standing, 3.0, 0.1)
    assert tracker.answer is not None and tracker.answer.solved and not tracker.fault
    np.testing.assert_allclose(tracker.answer.forces.sum(axis=0), [0, 0, tracked.mass * GRAVITY], atol=6.0)
    assert tracker.clock_s == pytest.approx(3.0 + 0.1 - DT)


def test_an_early_foot_stands_at_once(tracked: TrackedRobot, standing: MeasuredState) -> None:
    tracker = make(tracked)
    lifted = standing._replace(forces=np.array([0.0, 1.0, 1.0, 0.0]) * standing.forces[0] * 2)
    end = run(tracker, lifted, 0.0, 0.1 + 0.3)
    assert tracker.contact.tolist() == [False, True, True, False]
    run(tracker, standing, end + DT, 2 * DT)
    assert tracker.contact.all()
    assert [landing.leg for landing in tracker.landings] == [0, 3]
    assert all(0.6 < landing.phase < 1.0 for landing in tracker.landings)
    assert tracker.landings[0].error_m == pytest.approx(0.05, abs=1e-6)  # this robot does not move


def test_trunk_or_centre_of_mass_is_held_at_the_planned_height(tracked: TrackedRobot, standing: MeasuredState) -> None:
    geometry = tracked.geometry
    angles, _ = geometry.joints(geometry.stance + np.array([[0, 0, 0.1], [0, 0, 0], [0, 0, 0], [0, 0, 0.1]]))
    forces = standing.forces * [0.0, 2.0, 2.0, 0.0]
    wanted = {}
    for held in ("trunk", "mass"):
        tracker = make(tracked)
        tracker.settings = replace(tracker.settings, held=held)
        run(tracker, standing._replace(joints=angles, forces=forces), 0.0, 0.2)
        assert tracker.wanted is not None and tracker.contact.tolist() == [False, True, True, False]
        wanted[held] = tracker.wanted.com[0, 2] - tracker.terms.com[2]
    assert abs(wanted["trunk"]) < abs(wanted["mass"])  # the trunk is where it shall be, the centre of mass above it


def test_the_clock_waits_for_a_late_foot_and_in_the_end_the_robot_stops(
    tracked: TrackedRobot, standing: MeasuredState
) -> None:
    tracker = make(tracked, stride=0.02)
    lifted = standing._replace(forces=np.array([0.0, 1.0, 1.0, 0.0]) * standing.forces[0] * 2)
    end = run(tracker, lifted, 0.0, 0.9)
    assert tracker.clock_s == pytest.approx(0.5, abs=2 * DT)
    assert not tracker.fault
    assert tracker.wanted is not None and tracker.wanted.swing[0, 0, 2] < tracked.geometry.foot_radius - 0.01
    run(tracker, lifted, end + DT, 0.8)
    assert "FL found no ground" in tracker.fault


def test_a_late_foot_that_is_caught_beside_its_foothold_swings_again(
    tracked: TrackedRobot, standing: MeasuredState
) -> None:
    tracker = make(tracked, stride=0.12)
    forces = np.array([0.0, 1.0, 1.0, 0.0]) * standing.forces[0] * 2
    caught = standing._replace(forces=forces)
    end = run(tracker, caught, 0.0, 0.1 + 0.4 + 0.1)
    assert tracker.phase(0) > 1.0  # searches
    end = run(tracker, caught, end + DT, 0.2)
    assert 0.0 < tracker.phase(0) < 0.5
    assert tracker.contact.tolist() == [False, True, True, False]
    assert tracker.wanted is not None
    assert tracker.wanted.swing[0, 0, 2] > tracker.terms.feet[0, 2] + 0.02  # up and over
    run(tracker, standing, end + DT, 0.25)
    assert tracker.contact.all() and not tracker.fault
    tracker = make(tracked, stride=0.12)
    run(tracker, caught, 0.0, 4.0)  # nor for ever
    assert "found no ground" in tracker.fault


def test_a_pushed_body_steps_sooner_and_waits_on_four_feet(tracked: TrackedRobot, standing: MeasuredState) -> None:
    pushed = standing._replace(velocity=np.array([0.0, 0.8, *np.zeros(16)]))
    lifted = standing.forces * [0.0, 2.0, 2.0, 0.0]
    tracker = make(tracked)
    end = run(tracker, standing._replace(forces=lifted), 0.0, 0.2)
    assert not tracker.contact.all()
    began = tracker.clock_s
    run(tracker, pushed._replace(forces=lifted), end + DT, 0.1)
    assert 0.12 < tracker.clock_s - began < 0.15

    tracker = make(tracked)
    end = run(tracker, standing, 0.0, 0.05)
    began = tracker.clock_s
    end = run(tracker, pushed, end + DT, 0.7)
    assert tracker.clock_s == began and tracker.contact.all()
    run(tracker, pushed, end + DT, 0.2)  # nobody waits for ever
    assert not tracker.contact.all()


def test_a_foot_is_looked_for_while_the_clock_stands_still(tracked: TrackedRobot, standing: MeasuredState) -> None:
    """A foot that was about to lift hung in the air for as long as the robot waited, and was counted on."""
    lifts = np.array([True, False, False, True])
    tracker = make(tracked)
    end = run(tracker, standing, 0.0, 0.05)
    pushed = standing._replace(velocity=np.array([0.0, 0.8, *np.zeros(16)]))
    run(tracker, pushed._replace(forces=standing.forces * np.where(lifts, 0.0, 2.0)), end + DT, 0.2)
    assert tracker.contact.tolist() == (~lifts).tolist() and tracker.late().tolist() == lifts.tolist()


def test_a_body_comes_back_over_its_feet_before_any_lifts(tracked: TrackedRobot, standing: MeasuredState) -> None:
    """What is off by 5 cm as feet lift is off by 30 cm as they land: a swing of a trot lasts 1.7 / ω."""
    for speed, waits in ((0.05, False), (0.25, True)):
        tracker = make(tracked, stride=0.0)
        end = run(tracker, standing, 0.0, 0.05)
        began = tracker.clock_s
        run(tracker, standing._replace(velocity=np.array([0.0, speed, *np.zeros(16)])), end + DT, 0.1)
        assert (tracker.clock_s == began) == waits
        preview = tracker.preview
        assert preview is not None
        lifts_s = preview.times_s[:-1][~preview.standing.all(axis=1)].min() - preview.times_s[0]
        assert (lifts_s > 0.6) == waits  # the preview counts on it


def test_a_pushed_body_lets_its_feet_land_elsewhere(tracked: TrackedRobot, standing: MeasuredState) -> None:
    pushed = standing._replace(velocity=np.array([0.0, 0.8, *np.zeros(16)]))
    lifted = standing.forces * [0.0, 2.0, 2.0, 0.0]
    landed = {}
    for known in (False, True):
        tracker = make(tracked)
        tracker.settings = TrackerSettings(reassign_m=0.07)
        rows = [[replace(stance, movable_m=0.3) for stance in row] for row in tracker.plan.stances]
        tracker.follow(ContactPlan(rows))
        if known:
            x, y = np.meshgrid(np.arange(-0.5, 0.5, 0.02), np.arange(-0.5, 0.5, 0.02))
            points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
            tracker.footholds = Footholds(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
        end = run(tracker, standing._replace(forces=lifted), 0.0, 0.2)
        assert tracker.contact.tolist() == [False, True, True, False] and tracker.reassigned == 0
        run(tracker, pushed._replace(forces=lifted), end + DT, 0.05)
        landed[known] = [tracker.plan.next(leg, tracker.clock_s).place[1] for leg in (0, 3)]
        assert (tracker.reassigned > 0) == known
    assert np.subtract(landed[True], landed[False]).min() > 0.03  # to the side that the body goes to


def test_noise_of_the_force_sensors_is_no_touchdown(tracked: TrackedRobot, standing: MeasuredState) -> None:
    rng, noise = np.random.default_rng(0), 0.01
    quiet, noisy = make(tracked), make(tracked)
    noisy = Tracker(tracked, noisy.plan, settings=TrackerSettings(force_noise=noise))
    lifted = np.array([0.0, 1.0, 1.0, 0.0]) * standing.forces[0] * 2
    for tick in range(round(0.48 / DT)):
        forces = lifted + noise * tracked.mass * GRAVITY * rng.standard_normal(4)
        for tracker in (quiet, noisy):
            tracker.step(standing._replace(forces=forces), tick * DT)
    assert len(quiet.landings) >= 2  # what the usual rules make of it: both feet, and whatever they lose again
    assert not noisy.landings
    with pytest.raises(TrackingError, match="force_noise"):
        TrackerSettings(force_noise=0.2)


def test_a_spoiled_state_is_bridged_and_then_ends_the_walk(tracked: TrackedRobot, standing: MeasuredState) -> None:
    tracker = make(tracked)
    end = run(tracker, standing, 0.0, 0.05)
    spoiled = standing._replace(joints=np.full((4, 3), np.nan))
    before = tracker.step(standing, end + DT).copy()
    np.testing.assert_allclose(tracker.step(spoiled, end + 2 * DT), before, atol=0.5)
    assert not tracker.fault
    run(tracker, spoiled, end + 3 * DT, 0.1)
    assert "not finite" in tracker.fault
    assert tracker.plan.standing(100.0).all()
    assert all(stance.begin_s == -np.inf for leg in tracker.plan.stances for stance in leg)  # no foot lifts any more


def test_feet_whose_force_sensors_fail_are_not_lost(tracked: TrackedRobot, standing: MeasuredState) -> None:
    tracker = make(tracked, start_s=5.0)
    run(tracker, standing._replace(forces=np.full(4, np.nan)), 0.0, 0.2)
    assert tracker.contact.all() and not tracker.fault


def test_a_state_that_was_never_good_gives_no_torques(tracked: TrackedRobot, standing: MeasuredState) -> None:
    tracker = make(tracked)
    run(tracker, standing._replace(orientation=np.zeros(4)), 0.0, 0.1)
    assert tracker.fault and not tracker.step(standing._replace(orientation=np.zeros(4)), 0.1).any()


@pytest.mark.parametrize("time_s", [0.05, float("nan")])
def test_a_clock_that_stands_still_ends_the_walk(tracked: TrackedRobot, standing: MeasuredState, time_s: float) -> None:
    tracker = make(tracked)
    run(tracker, standing, 0.0, 0.05)
    for _ in range(40):
        assert np.isfinite(tracker.step(standing, time_s)).all()
    assert "clock stands still" in tracker.fault


def test_a_clock_that_jumps_ends_the_walk(tracked: TrackedRobot, standing: MeasuredState) -> None:
    tracker = make(tracked)
    run(tracker, standing, 0.0, 0.05)
    tracker.step(standing, 3.0)
    assert "jumped by 2.95 s" in tracker.fault


def test_torques_at_their_limits_for_long_end_the_walk(tracked: TrackedRobot, standing: MeasuredState) -> None:
    weak = replace(tracked, torque_limit=np.full((4, 3), 4.0))
    tracker = make(weak, start_s=5.0)
    end = run(tracker, standing, 0.0, 0.8)
    assert not tracker.fault
    run(tracker, standing, end + DT, 0.3)
    assert "has been at its limit for" in tracker.fault


def test_a_body_that_leans_too_far_ends_the_walk(tracked: TrackedRobot, standing: MeasuredState) -> None:
    tracker = make(tracked)
    tracker.step(standing._replace(orientation=np.array([np.cos(0.5), np.sin(0.5), 0.0, 0.0])), 0.0)
    assert "leans" in tracker.fault


def test_a_plan_out_of_reach_is_refused_and_the_robot_goes_on(tracked: TrackedRobot, standing: MeasuredState) -> None:
    with pytest.raises(TrackingError, match="out of reach"):
        make(tracked, stride=1.0)
    tracker = make(tracked)
    run(tracker, standing, 0.0, 0.05)
    places = tracked.geometry.stance * [1.0, 1.0, 0.0]
    with pytest.raises(TrackingError, match="out of reach"):
        high = [[place, np.add(place, (0.0, 0.0, 1.0))] for place in places]
        tracker.follow(plan_from_gait(GaitTiming.trot(), high, start_s=1.0))
    run(tracker, standing, 0.05, 0.05)
    assert not tracker.fault


@pytest.mark.parametrize(
    "changes", [{"friction": 0.0}, {"replan_s": 1.0}, {"swing_height_m": float("nan")}, {"held": "legs"}]
)
def test_settings_out_of_bounds_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(TrackingError, match=next(iter(changes))):
        TrackerSettings(**changes)
