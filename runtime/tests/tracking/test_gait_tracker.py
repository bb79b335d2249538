"""What the gait tracker decides from what it measures; walks in MuJoCo are in ``tests/sim/walks/test_vital.py``."""

from __future__ import annotations

import numpy as np
import pytest

from legtool_runtime.errors import TrackingError
from legtool_runtime.tracking.dynamics import GRAVITY
from legtool_runtime.tracking.gait_tracker import GaitTracker, Guidance
from legtool_runtime.tracking.gaits import GaitTiming
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.selectors import Place, Wish, any_place
from legtool_runtime.tracking.tracker import MeasuredState

DT = 0.0025


@pytest.fixture
def standing(tracked: TrackedRobot) -> MeasuredState:
    geometry = tracked.geometry
    angles, _ = geometry.joints(geometry.stance)
    forces = np.full(4, tracked.mass * GRAVITY / 4)
    position = np.array([0.0, 0.0, geometry.standing_height])
    return MeasuredState(position, np.array([1.0, 0.0, 0.0, 0.0]), angles, np.zeros(18), forces)


def guidance(command=(0.2, 0.0, 0.0), select=None, pose=None) -> Guidance:
    return Guidance(command, select or any_place(None), pose)


def lift(gait: GaitTracker, standing: MeasuredState, given: Guidance, *, seconds: float = 0.35) -> None:
    for tick in range(round(seconds / DT)):
        torques = gait.step(standing, tick * DT, given)
        assert np.isfinite(torques).all()


def test_the_feet_that_lift_are_given_their_footholds_then(tracked: TrackedRobot, standing: MeasuredState) -> None:
    gait = GaitTracker(tracked, GaitTiming.trot_at(0.2))
    lift(gait, standing, guidance())
    assert gait.tracker is not None and not gait.tracker.fault
    first = gait.chosen[:2]
    assert [(one.leg, one.phase) for one in first] == [(0, 0.0), (3, 0.0)]
    for one in first:
        following = gait.tracker.plan.next(one.leg, gait.tracker.clock_s)
        assert following is not None
        np.testing.assert_allclose(following.place[:2], one.choice.place.point[:2])
        # Ahead of where the leg stands, for the trunk is to walk.
        assert one.choice.place.point[0] > tracked.geometry.stance[one.leg, 0] + 0.02


def test_the_gait_is_foretold_beyond_the_horizon(tracked: TrackedRobot, standing: MeasuredState) -> None:
    gait = GaitTracker(tracked, GaitTiming.trot_at(0.2))
    lift(gait, standing, guidance())
    assert gait.tracker is not None
    plan = gait.tracker.plan
    assert min(row[-1].begin_s for row in plan.stances) > gait.tracker.clock_s + 2.0
    front = [stance.place[0] for stance in plan.stances[0][1:]]
    cycle = GaitTiming.trot_at(0.2).cycle_s
    np.testing.assert_allclose(np.diff(front)[1:], 0.2 * cycle, atol=1e-6)


def test_a_foot_goes_where_the_selector_says(tracked: TrackedRobot, standing: MeasuredState) -> None:
    wishes: list[Wish] = []

    def aside(wish: Wish) -> Place:
        wishes.append(wish)
        return Place(np.array([*np.add(wish.nominal, (0.0, 0.03)), 0.0]), np.array([0.0, 0.0, 1.0]))

    gait = GaitTracker(tracked, GaitTiming.trot_at(0.2))
    lift(gait, standing, guidance(select=aside))
    np.testing.assert_allclose(gait.chosen[0].choice.place.point[:2], np.add(wishes[0].nominal, (0.0, 0.03)))
    assert wishes[0].twist[0] == 0.2 and wishes[0].gait.swing_phase == pytest.approx(0.0)


def test_without_a_safe_place_a_foot_goes_back_and_the_trunk_waits(
    tracked: TrackedRobot, standing: MeasuredState
) -> None:
    gait = GaitTracker(tracked, GaitTiming.trot_at(0.2))
    lift(gait, standing, guidance(select=lambda wish: None))
    assert [one.choice.by for one in gait.chosen[:2]] == ["back", "back"]
    assert gait.tracker is not None
    for one in gait.chosen[:2]:
        np.testing.assert_allclose(one.choice.place.point[:2], tracked.geometry.stance[one.leg, :2], atol=1e-6)
    # The plan that follows is that of a trunk that stands.
    places = np.array([[row[-1].place[:2] for row in gait.tracker.plan.stances]])
    assert np.abs(places - tracked.geometry.stance[:, :2]).max() < 0.01


def test_unpaced_the_trunk_walks_on_where_feet_stay_behind(tracked: TrackedRobot, standing: MeasuredState) -> None:
    speeds = {}
    for paced in (True, False):
        gait = GaitTracker(tracked, GaitTiming.trot_at(0.2))
        lift(gait, standing, guidance(select=lambda wish: None)._replace(paced=paced))
        assert gait.tracker is not None and gait.tracker.reference is not None
        speeds[paced] = gait.tracker.reference.at(gait.tracker.clock_s + 1.0).velocity[0]
    assert abs(speeds[True]) < 0.02 and speeds[False] > 0.1


def test_a_crawl_lifts_one_foot_at_a_time(tracked: TrackedRobot, standing: MeasuredState) -> None:
    gait = GaitTracker(tracked, GaitTiming.crawl_online())
    lift(gait, standing, guidance((0.1, 0.0, 0.0)))
    assert [one.leg for one in gait.chosen if one.phase == 0.0] == [2]


def test_a_pose_is_gone_over_to_without_a_jump(tracked: TrackedRobot, standing: MeasuredState) -> None:
    gait = GaitTracker(tracked, GaitTiming.trot_at(0.0))
    height = tracked.geometry.standing_height
    pose = np.array([height - 0.05, 0.0, 0.1])
    gait.step(standing, 0.0, guidance(pose=pose))
    assert gait.tracker is not None and gait.tracker.filtered_pose is not None
    np.testing.assert_allclose(gait.tracker.filtered_pose, [height, 0.0, 0.0], atol=1e-3)
    for tick in range(1, 100):
        gait.step(standing, tick * DT, guidance(pose=pose))
    filtered = gait.tracker.filtered_pose
    assert height - 0.05 < filtered[0] < height - 0.02 and 0.03 < filtered[2] < 0.1
    gait.step(standing, 100 * DT, guidance())
    assert gait.tracker.filtered_pose is None


USELESS = pytest.mark.parametrize(
    "given",
    [guidance((np.nan, 0.0, 0.0)), guidance((0.2, np.inf, 0.0)), guidance((0.2, 0.0)), guidance(pose=np.zeros(2))],
    ids=["nan", "infinite", "two numbers", "half a pose"],
)


@USELESS
def test_guidance_that_cannot_be_is_refused(tracked: TrackedRobot, standing: MeasuredState, given: Guidance) -> None:
    with pytest.raises(TrackingError):
        GaitTracker(tracked, GaitTiming.trot_at(0.2)).step(standing, 0.0, given)


@USELESS
def test_in_mid_walk_it_brings_the_robot_to_a_stand(
    tracked: TrackedRobot, standing: MeasuredState, given: Guidance
) -> None:
    gait = GaitTracker(tracked, GaitTiming.trot_at(0.2))
    lift(gait, standing, guidance(), seconds=0.1)
    for tick in range(40, 80):
        assert np.isfinite(gait.step(standing, tick * DT, given)).all()
    assert gait.tracker is not None and gait.tracker.fault.startswith("gait: ")
    assert all(np.isinf(row[-1].end_s) for row in gait.tracker.plan.stances)


def test_so_does_a_place_that_cannot_be(tracked: TrackedRobot, standing: MeasuredState) -> None:
    nowhere = Guidance((0.2, 0.0, 0.0), lambda wish: Place(np.full(3, np.nan), np.array([0.0, 0.0, 1.0])))
    gait = GaitTracker(tracked, GaitTiming.trot_at(0.2))
    lift(gait, standing, nowhere, seconds=0.6)
    assert gait.tracker is not None and "expected" in gait.tracker.fault


def test_a_state_that_is_not_finite_ends_the_walk_and_throws_nothing(
    tracked: TrackedRobot, standing: MeasuredState
) -> None:
    gait = GaitTracker(tracked, GaitTiming.trot_at(0.2))
    lift(gait, standing, guidance(), seconds=0.1)
    broken = standing._replace(position=np.array([np.nan, 0.0, 0.0]))
    for tick in range(40, 80):
        assert np.isfinite(gait.step(broken, tick * DT, guidance())).all()
    assert gait.tracker is not None and "not finite" in gait.tracker.fault
