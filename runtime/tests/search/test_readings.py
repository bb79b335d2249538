"""What the monitor is told of a tracker that stands and lifts feet, and of the candidates of a frame."""

import dataclasses
import math

import numpy as np
import pytest
from true_regions import rectangle, regions_of

from legtool_runtime.search.candidates import find_candidates
from legtool_runtime.search.readings import take_reading
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance
from legtool_runtime.tracking.dynamics import GRAVITY
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.tracker import MeasuredState, Tracker

DT = 0.0025
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def tracked(anymal):
    ball = lambda *lead: np.broadcast_to(0.01 * np.eye(3), (*lead, 3, 3))  # noqa: E731
    return TrackedRobot(
        geometry=anymal, trunk_mass=30.0, trunk_com=np.zeros(3), trunk_inertia=np.eye(3),
        link_mass=np.full((4, 3), 1.5), link_com=np.zeros((4, 3, 3)), link_inertia=ball(4, 3),
        armature=np.full((4, 3), 0.02), joint_friction=np.zeros((4, 3)), joint_damping=np.zeros((4, 3)),
        torque_limit=np.full((4, 3), 80.0),
    )  # fmt: skip


def standing(tracked, forces=(0.25, 0.25, 0.25, 0.25)):
    robot = tracked.geometry
    angles, _ = robot.joints(robot.stance)
    weight = tracked.mass * GRAVITY
    height = robot.foot_radius - robot.stance[:, 2].mean()
    return MeasuredState(
        np.array([0.0, 0.0, height]), np.array([1.0, 0, 0, 0]), angles, np.zeros(18), weight * np.asarray(forces)
    )


def stepping(robot, lift_s=0.1, steps=2):
    """Front left and rear right step ahead again and again."""
    places = robot.stance * [1.0, 1.0, 0.0]
    rows = [[Stance(-math.inf, math.inf, place, UP)] for place in places]
    for k in range(steps):
        at = lift_s + 0.5 * k
        for leg in (0, 3):
            rows[leg][-1] = dataclasses.replace(rows[leg][-1], end_s=at)
            rows[leg].append(Stance(at + 0.3, math.inf, places[leg] + [0.05 * (k + 1), 0.0, 0.0], UP))
    return ContactPlan(rows)


def walked(tracked, seconds, steps=2, lifted=None, **changes):
    """A tracker after some time with one measurement; from the first lift-off on with other forces, if given."""
    tracker, state = Tracker(tracked, stepping(tracked.geometry, steps=steps)), standing(tracked)._replace(**changes)
    for tick in range(round(seconds / DT)):
        if lifted is not None and tick * DT >= 0.1:
            state = standing(tracked, lifted)
        tracker.step(state, tick * DT)
    return tracker, state


def test_a_robot_that_stands_where_it_should(tracked):
    tracker, state = walked(tracked, 0.05)
    got = take_reading(tracker, state, 3.0, age_s=0.2)
    assert got.time_s == 3.0 and got.clock_s == tracker.clock_s and got.age_s == 0.2
    assert got.stands.tolist() == [1, 1, 1, 1] and not got.late.any() and not got.phases.any()
    assert got.loads == pytest.approx(np.full(4, 0.25))
    assert got.feet == pytest.approx(tracked.geometry.stance * [1, 1, 0], abs=1e-3)
    assert got.places == pytest.approx(got.feet, abs=1e-3)
    assert got.ahead == 2 and got.final == 0.0 and got.speed == pytest.approx(0.0)
    assert np.isnan(got.margins).all() and np.isnan(got.seen).all()
    assert np.abs(got.lean).max() < 0.02 and np.abs(got.torques).max() <= 1.0


def test_a_foot_in_the_air_goes_to_its_place(tracked):
    tracker, state = walked(tracked, 0.25, lifted=(0.0, 0.5, 0.5, 0.0))
    got = take_reading(tracker, state, 0.25)
    assert got.stands[0] == 0.0 and 0.4 < got.phases[0] < 0.6 and got.ahead == 1
    assert got.places[0] == pytest.approx(tracked.geometry.stance[0] * [1, 1, 0] + [0.05, 0, 0])


def test_lean_and_offset_are_off_the_bodys_reference(tracked):
    pitch = 0.2
    turned = np.array([math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0])
    place = np.add(standing(tracked).position, (0.05, -0.02, 0.03))
    velocity = np.arange(18.0) * 0.01
    tracker, state = walked(tracked, 0.01, steps=0, orientation=turned, position=place, velocity=velocity)
    got = take_reading(tracker, state, 0.0)
    assert got.lean == pytest.approx([0.0, pitch], abs=0.03)
    assert got.turning == pytest.approx(velocity[3:6]) and got.joint_speeds == pytest.approx(velocity[6:])
    assert got.off[1] == pytest.approx(-0.02, abs=0.015)


def test_candidates_tell_of_margins_and_of_places_that_are_gone(tracked):
    tracker, state = walked(tracked, 0.05)
    feet = tracked.geometry.stance
    wide = rectangle((0.0, 0.0, 0.0), (3.0, 3.0))
    stone = rectangle((feet[0, 0], feet[0, 1], 0.0), (0.16, 0.16))
    rear = [rectangle((feet[leg, 0], feet[leg, 1], 0.0), (0.5, 0.5)) for leg in (2, 3)]
    known = lambda faces: find_candidates(regions_of(faces), position=(0.0, 0.0, 0.5))[0]  # noqa: E731
    got = take_reading(tracker, state, 0.0, candidates=known([wide]), frame=True)
    assert got.seen.tolist() == [1, 1, 1, 1] and got.margins.min() > 0.0
    got = take_reading(tracker, state, 0.0, candidates=known([stone, *rear]), frame=True)
    assert got.seen[1] == 0.0 and got.margins[1] < 0.0  # nothing under the front right foot
    assert -0.04 < got.margins[0] <= 0.08
    assert np.isnan(take_reading(tracker, state, 0.0, candidates=known([wide])).seen).all()
