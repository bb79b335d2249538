"""Motions that are accepted hold in a plain check; those that are refused name the rule."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_check import faults, turned
from true_regions import rectangle, regions_of

from legtool_runtime.errors import PlannerError
from legtool_runtime.search.swings.optimiser import SwingOptimiser, SwingState
from legtool_runtime.search.swings.settings import SwingSettings
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.gaits import GaitTiming, plan_from_gait
from legtool_runtime.tracking.model import TrackedRobot


def flat() -> HeightMap:
    return HeightMap(np.zeros((120, 80), np.float32), 0.02, np.zeros(2))


def checked(one: SwingOptimiser, motion, plan) -> list[str]:
    s = one.settings
    return faults(one.robot, motion, plan, friction=s.friction, speed=one.joint_speed)


def test_a_trot_on_level_ground_holds_in_the_plain_check(optimiser: SwingOptimiser, trot) -> None:
    plan, state = trot(), None
    for k in range(3):
        start_s = 0.3 + 0.48 * k
        motion = optimiser.optimise(plan, start_s=start_s, start=state, elevation=flat())
        assert motion.accepted and motion.converged, motion.reason
        assert not checked(optimiser, motion, plan)
        assert motion.times_s[-1] == pytest.approx(start_s + 0.48)
        if state is not None:  # momentum is kept from one to the next
            np.testing.assert_allclose(motion.momentum[0], state.momentum, atol=1e-12)
            np.testing.assert_allclose(motion.velocity[0], state.velocity, atol=1e-12)
        state = motion.state(motion.times_s[-1])


def test_swinging_feet_clear_the_ground_and_land_on_their_footholds(optimiser: SwingOptimiser, trot) -> None:
    plan = trot()
    motion = optimiser.optimise(plan, start_s=0.3, elevation=flat())
    middle = int(np.searchsorted(motion.times_s, 0.5))
    radius = optimiser.robot.geometry.foot_radius
    for leg in range(4):
        if motion.standing[middle, leg]:
            continue
        assert motion.feet[middle, leg, 2] > radius + 0.05
        landed = int(np.searchsorted(motion.times_s, 0.7 - 1e-6))
        np.testing.assert_allclose(motion.feet[landed, leg] - [0, 0, radius], plan.stances[leg][1].place, atol=1e-4)


def test_a_crawl_and_a_window_of_three_transitions(walker: TrackedRobot) -> None:
    feet = walker.geometry.stance * [1.0, 1.0, 0.0]
    rows = [np.stack([f, np.add(f, (0.1, 0.0, 0.02))]) for f in feet]
    plan = plan_from_gait(GaitTiming.crawl(), rows, start_s=0.3)
    one = SwingOptimiser(walker, SwingSettings(window=3))
    motion = one.optimise(plan, start_s=0.3)
    assert motion.accepted, motion.reason
    assert motion.times_s[-1] == pytest.approx(0.3 + 3 * 0.75)
    assert not checked(one, motion, plan)


def test_what_the_body_begins_with_is_what_it_is_given(optimiser: SwingOptimiser, trot) -> None:
    plan = trot()
    usual = optimiser.optimise(plan, start_s=0.3)
    state = usual.state(0.3)
    pushed = state._replace(velocity=np.add(state.velocity, (0, 0.05, 0)), com=np.add(state.com, (0.01, 0, 0)))
    motion = optimiser.optimise(plan, start_s=0.3, start=pushed)
    assert motion.accepted, motion.reason
    np.testing.assert_allclose(motion.velocity[0], pushed.velocity)
    np.testing.assert_allclose(motion.com[0], pushed.com)
    assert not checked(optimiser, motion, plan)


def test_a_foothold_out_of_reach_is_refused(optimiser: SwingOptimiser, trot) -> None:
    motion = optimiser.optimise(trot(stride=1.3), start_s=0.3)
    assert not motion.accepted and motion.rule == "reach" and "does not get to" in motion.reason


def test_ground_that_is_too_slippery_is_refused(walker: TrackedRobot, trot) -> None:
    slope = (np.sin(0.4), 0.0, np.cos(0.4))
    holds = SwingOptimiser(walker).optimise(trot(normal=slope), start_s=0.3)
    assert holds.accepted, holds.reason
    slips = SwingOptimiser(walker, SwingSettings(friction=0.3)).optimise(trot(normal=slope), start_s=0.3)
    assert not slips.accepted and slips.rule == "friction"
    assert slips.worst["friction"] > 0.0


def test_a_wall_in_the_way_is_refused(optimiser: SwingOptimiser, trot) -> None:
    heights = np.zeros((120, 80), np.float32)
    x = (np.arange(120) - 59.5) * 0.02
    heights[(x > 0.405) & (x < 0.435)] = 0.45  # between the front feet's footholds
    motion = optimiser.optimise(trot(), start_s=0.3, elevation=HeightMap(heights, 0.02, np.zeros(2)))
    assert not motion.accepted and motion.rule == "clearance"


def test_motors_that_are_too_weak_are_refused(walker: TrackedRobot, trot) -> None:
    weak = replace(walker, torque_limit=np.full((4, 3), 20.0))
    motion = SwingOptimiser(weak).optimise(trot(), start_s=0.3)
    assert not motion.accepted and motion.rule == "torque" and motion.worst["torque"] > 1.0


def test_footholds_off_all_regions_are_refused(optimiser: SwingOptimiser, trot) -> None:
    plan = trot()
    floor, short = rectangle([0.0, 0.0, 0.0], (3.0, 2.0)), rectangle([-1.0, 0.0, 0.0], (2.7, 2.0))
    assert optimiser.optimise(plan, start_s=0.3, regions=regions_of([floor])).accepted
    motion = optimiser.optimise(plan, start_s=0.3, regions=regions_of([short]))  # ends before the front footholds
    assert not motion.accepted and motion.rule == "polygon" and "FL" in motion.reason


def test_passes_are_a_limit_with_an_answer(walker: TrackedRobot, trot) -> None:
    plan = trot()
    state = SwingOptimiser(walker).optimise(plan, start_s=0.3).state(0.3)
    tilted = state._replace(rotation=state.rotation @ turned(np.array([0.08, 0.1, 0.0])))
    whole = SwingOptimiser(walker).optimise(plan, start_s=0.3, start=tilted)
    assert whole.accepted, whole.reason
    for passes in (1, 2):
        motion = SwingOptimiser(walker, SwingSettings(passes=passes)).optimise(plan, start_s=0.3, start=tilted)
        assert motion.passes == passes < whole.passes
        assert np.isfinite(motion.com).all() and motion.com.shape == whole.com.shape
        assert not motion.converged
    once = SwingOptimiser(walker, SwingSettings(passes=1)).optimise(plan, start_s=0.3, start=tilted)
    assert not once.accepted and once.worst["defect"] > 1e-3


@pytest.mark.parametrize("entry", SwingState._fields)
def test_values_that_are_not_finite_are_refused_at_the_door(optimiser: SwingOptimiser, trot, entry: str) -> None:
    state = optimiser.optimise(trot(), start_s=0.3).state(0.3)
    broken = getattr(state, entry).copy()
    broken.flat[0] = np.nan
    with pytest.raises(PlannerError, match=entry):
        optimiser.optimise(trot(), start_s=0.3, start=state._replace(**{entry: broken}))
    with pytest.raises(PlannerError, match="no rotation"):
        optimiser.optimise(trot(), start_s=0.3, start=state._replace(rotation=2.0 * state.rotation))
    with pytest.raises(PlannerError, match="finite time"):
        optimiser.optimise(trot(), start_s=np.nan)


def test_settings_out_of_bounds_are_refused() -> None:
    for wrong in ({"passes": 0}, {"friction": np.nan}, {"knot_s": 1.0}, {"window": 4}, {"barrier": 0.0}):
        with pytest.raises(PlannerError, match="swing optimisation"):
            SwingSettings(**wrong)


def test_a_plan_that_is_over_is_a_stand(optimiser: SwingOptimiser, walker: TrackedRobot) -> None:
    feet = walker.geometry.stance * [1.0, 1.0, 0.0]
    plan: ContactPlan = plan_from_gait(GaitTiming.trot(), [f[None] for f in feet], start_s=0.0)
    motion = optimiser.optimise(plan, start_s=2.0)
    assert motion.accepted, motion.reason
    np.testing.assert_allclose(
        motion.forces.sum(axis=1), np.tile([0.0, 0.0, 9.81 * walker.mass], (len(motion.forces), 1)), atol=15.0
    )
