"""How the trunk's height is told from the centre of mass's."""

from __future__ import annotations

import numpy as np
import pytest

from legtool_runtime.legs import Legs
from legtool_runtime.tracking.dynamics import FullState, dynamics_terms, make_terms
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.wanted import lifted

UP = np.tile([0.0, 0.0, 1.0], (4, 1))


def state_of(tracked: TrackedRobot, lift: float, velocity: np.ndarray) -> FullState:
    """FL and RR are lifted off the stance by so much."""
    geometry = tracked.geometry
    angles, _ = geometry.joints(geometry.stance + np.array([[0, 0, lift], [0, 0, 0], [0, 0, 0], [0, 0, lift]]))
    return FullState(np.array([0.3, 0.1, geometry.standing_height]), np.array([1.0, 0, 0, 0]), angles, velocity)


def measure(tracked: TrackedRobot, state: FullState, stands: list[bool]) -> tuple[float, float, np.ndarray]:
    terms = make_terms()
    dynamics_terms(tracked.model(), state, UP, terms)
    moving = (terms.com, terms.com_velocity, terms.rotation, state.position, state.velocity)
    legs = Legs.of(tracked.geometry, tracked.com)
    return *lifted(moving, tracked.com, legs, terms.feet, np.array(stands)), terms.com


def test_lifted_feet_lift_the_centre_of_mass_off_the_trunk(tracked: TrackedRobot) -> None:
    height, _, com = measure(tracked, state_of(tracked, 0.0, np.zeros(18)), [True] * 4)
    assert height == pytest.approx(0.0, abs=1e-3)
    higher, rate, above = measure(tracked, state_of(tracked, 0.12, np.zeros(18)), [False, True, True, False])
    assert higher == pytest.approx(above[2] - com[2], abs=1e-3)
    assert higher > 0.002
    assert rate == 0.0


def test_the_rate_is_that_of_the_height(tracked: TrackedRobot) -> None:
    before, after = (state_of(tracked, lift, np.zeros(18)) for lift in (0.0999, 0.1001))
    velocity = np.array([0.0, 0.0, 0.4, 0.3, -0.2, 0.0, *((after.joints - before.joints).ravel() / 0.0002)])
    swings = [False, True, True, False]
    _, rate, _ = measure(tracked, state_of(tracked, 0.1, velocity), swings)
    slope = (measure(tracked, after, swings)[0] - measure(tracked, before, swings)[0]) / 0.0002
    _, turned, _ = measure(tracked, state_of(tracked, 0.1, np.array([0, 0, 0.4, 0.3, -0.2, 0, *np.zeros(12)])), swings)
    assert rate == pytest.approx(slope + turned, abs=1e-4)


def test_a_standing_leg_at_its_longest_lets_the_trunk_sag(tracked: TrackedRobot) -> None:
    state = state_of(tracked, 0.12, np.zeros(18))
    legs = Legs.of(tracked.geometry, tracked.com)
    geometry = tracked.geometry
    down = geometry.stance.copy()
    down[1, 2] = geometry.hips[1, 2] - legs.longest[1] - 0.01
    angles, _ = geometry.joints(down)
    joints = state.joints.copy()
    joints[1] = angles[1]
    stretched = state._replace(joints=joints)
    assert measure(tracked, stretched, [False, True, True, False])[:2] == (0.0, 0.0)
    assert measure(tracked, stretched, [False, False, True, False])[0] != 0.0
