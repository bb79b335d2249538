"""Body references of optimised motions, and the controller's own where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from legtool_runtime.search.swings.walked_references import OptimisedReferences, interpolate
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
    off = max(
        np.abs(given.at(t).position - com).max() for t, com in zip(motion.times_s[3:], motion.com[3:], strict=True)
    )
    assert off < 1.5e-3
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


def test_a_motion_that_is_refused_leaves_the_controllers_own_reference(walker: TrackedRobot, trot) -> None:
    weak = replace(walker, torque_limit=np.full((4, 3), 20.0))
    plan, makes = trot(steps=6), OptimisedReferences(weak)
    given = makes.from_contacts(plan, start_s=0.3, horizon_s=1.1)
    usual = ReferenceMaker(walker.geometry, com_offset=walker.com).from_contacts(plan, start_s=0.3, horizon_s=1.1)
    assert makes.refused == ["torque"] and makes.motion is None
    np.testing.assert_array_equal(given.control, usual.control)
