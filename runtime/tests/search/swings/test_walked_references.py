"""Body references of optimised motions, and the controller's own where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from legtool_runtime.search.swings.walked_references import OptimisedReferences, interpolate, transition_ahead
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.body_reference import BodyReference, ReferenceMaker
from legtool_runtime.tracking.model import TrackedRobot


def test_the_spline_goes_through_its_values() -> None:
    values = np.cumsum(np.random.default_rng(0).normal(size=(30, 6)), axis=0)
    control = values.copy()
    interpolate(control)
    spline = BodyReference(1.0, 0.05, control)
    for k in range(1, 29):
        point = spline.at(1.0 + 0.05 * k)
        np.testing.assert_allclose(np.concatenate([point.position, point.attitude]), values[k], atol=1e-9)


def test_the_body_follows_the_motion_and_then_its_own_reference(walker: TrackedRobot, trot) -> None:
    plan, makes = trot(steps=6), OptimisedReferences(walker)
    own = ReferenceMaker(walker.geometry, com_offset=walker.com)
    given = makes.from_contacts(plan, start_s=0.3, horizon_s=3.0)
    usual = own.from_contacts(plan, start_s=0.3, horizon_s=3.0)
    motion = makes.motion
    assert motion is not None and motion.accepted and not makes.refused
    for k in range(3, len(motion.times_s)):
        point = given.at(motion.times_s[k])
        np.testing.assert_allclose(point.position[:2], motion.com[k, :2], atol=1.5e-3)
        trunk = point.position - point.rotation @ walker.com  # its height is the trunk's
        np.testing.assert_allclose(trunk[2], motion.base[k, 2], atol=1.5e-3)
    ends = motion.times_s[-1]
    assert max(np.abs(usual.at(t).position - motion.state(t).com).max() for t in motion.times_s) > 3e-3
    np.testing.assert_allclose(given.at(ends + 0.5).position, usual.at(ends + 0.5).position, atol=1e-4)


def test_a_motion_is_kept_while_nothing_changes_and_made_anew_where_a_foot_lands_elsewhere(
    walker: TrackedRobot, trot
) -> None:
    plan, makes = trot(steps=6), OptimisedReferences(walker)
    for k in range(5):
        makes.from_contacts(plan, start_s=0.3 + 0.02 * k, horizon_s=1.1)
    assert len(makes.times_s) == 1
    before = makes.motion
    landed = plan.touched_down(0, 0.68, np.add(plan.stances[0][1].place, (0.004, 0.0, 0.0)))
    makes.from_contacts(landed, start_s=0.68, horizon_s=1.1)
    assert len(makes.times_s) == 2 and makes.motion is not before
    np.testing.assert_allclose(makes.motion.velocity[0], before.state(0.68).velocity, atol=1e-9)


def test_a_reference_does_not_jump_where_a_motion_is_refused(walker: TrackedRobot, trot) -> None:
    plan, makes = trot(steps=6), OptimisedReferences(walker)
    makes.from_contacts(plan, start_s=0.3, horizon_s=1.1)
    before = makes.from_contacts(plan, start_s=0.66, horizon_s=1.1)
    makes.optimiser = OptimisedReferences(replace(walker, torque_limit=np.full((4, 3), 5.0))).optimiser
    landed = plan.touched_down(0, 0.68, np.add(plan.stances[0][1].place, (0.004, 0.0, 0.0)))
    after = makes.from_contacts(landed, start_s=0.68, horizon_s=1.1)
    assert makes.refused == ["torque"] and makes.motion is None
    own = ReferenceMaker(walker.geometry, com_offset=walker.com).from_contacts(landed, start_s=0.68, horizon_s=1.1)
    off = np.linalg.norm(before.at(0.68).position - own.at(0.68).position)
    assert off > 2e-3
    assert np.linalg.norm(after.at(0.68).position - before.at(0.68).position) < 0.5 * off
    np.testing.assert_allclose(after.at(1.0).position, own.at(1.0).position, atol=1e-3)


def test_a_wall_far_ahead_leaves_a_motion_over_the_transitions_before_it(walker: TrackedRobot, trot) -> None:
    heights = np.zeros((200, 80), np.float32)
    x = (np.arange(200) - 99.5) * 0.02
    heights[(x > 0.525) & (x < 0.555)] = 0.45  # the front feet's second steps lead over it
    wall = HeightMap(heights, 0.02, np.zeros(2))
    plan, makes = trot(steps=6), OptimisedReferences(walker)
    assert not makes.optimiser.optimise(plan, start_s=0.3, elevation=wall).accepted
    makes.from_contacts(plan, start_s=0.3, horizon_s=1.1, elevation=wall)
    assert makes.motion is not None and not makes.refused and len(makes.times_s) == 2
    assert makes.motion.times_s[-1] < 0.3 + 3 * 0.48 - 1e-6
    rule, before, after = makes.refusals[0]  # the third transition is that over the wall
    assert len(makes.refusals) == 1 and rule == "clearance"
    np.testing.assert_array_equal((before, after), transition_ahead(plan, 0.3, 3))


def test_a_motion_that_is_refused_leaves_the_controllers_own_reference(walker: TrackedRobot, trot) -> None:
    weak = replace(walker, torque_limit=np.full((4, 3), 20.0))
    plan, makes = trot(steps=6), OptimisedReferences(weak)
    given = makes.from_contacts(plan, start_s=0.3, horizon_s=1.1)
    usual = ReferenceMaker(walker.geometry, com_offset=walker.com).from_contacts(plan, start_s=0.3, horizon_s=1.1)
    assert makes.refused == ["torque"] and makes.motion is None
    np.testing.assert_array_equal(given.control, usual.control)


def test_a_transition_ahead_is_told_by_the_feet_before_and_after_it(trot) -> None:
    plan = trot(steps=3)
    lifts = sorted({s.end_s for row in plan.stances for s in row if np.isfinite(s.end_s)})
    start = np.array([row[0].place for row in plan.stances])
    before, after = transition_ahead(plan, 0.0, 1)
    np.testing.assert_array_equal(before, start)
    moved = np.flatnonzero((before != after).any(axis=1)).tolist()
    assert moved == [leg for leg in range(4) if plan.stances[leg][0].end_s == lifts[0]]
    following, _ = transition_ahead(plan, 0.0, 2)
    np.testing.assert_array_equal(following, after)
    assert transition_ahead(plan, lifts[0] + 0.01, 1) is None  # in the air
    np.testing.assert_array_equal(transition_ahead(plan, lifts[0] + 0.01, 2)[0], after)
    assert transition_ahead(plan, plan.end_s, 1) is None
