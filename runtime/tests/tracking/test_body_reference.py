import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stones_and_bodies import BODIES, stones

from legtool_runtime.errors import TrackingError
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.body_reference import PoseFilter, ReferenceMaker
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance
from legtool_runtime.tracking.gaits import GaitTiming, plan_from_gait
from legtool_runtime.tracking.ground import ground_of
from legtool_runtime.tracking.reach import Legs, depths_of, fit_poses, leg_points, leg_span

INF, UP = float("inf"), np.array([0, 0, 1.0])


def standing_on(robot, heights):
    places = robot.stance * [1, 1, 0] + np.outer(heights, [0, 0, 1])
    return ContactPlan([[Stance(-INF, INF, places[leg], UP)] for leg in range(4)])


def spans(maker, plan, reference, t):
    """Lengths of the standing legs, by the robot's own kinematics."""
    point = reference.at(t)
    out = np.full(4, np.nan)
    base = point.position - point.rotation @ maker.com_offset
    for leg in range(4):
        stance = plan.current(leg, t)
        if stance is not None:
            x, y, z = (
                point.rotation.T @ (stance.place + np.array([0, 0, maker.robot.foot_radius]) - base)
                - maker.robot.hips[leg]
            )
            out[leg] = np.sqrt(x * x + y * y + z * z - maker.robot.abduction_offset[leg] ** 2)
    return out


@pytest.mark.parametrize("name", BODIES)
def test_a_robot_that_stands_on_even_ground_stands_at_its_height(name):
    robot = BODIES[name][0]
    com = np.array([0.01, 0.0, -0.02])
    maker = ReferenceMaker(robot, com_offset=com)
    reference = maker.from_contacts(standing_on(robot, np.full(4, 0.3)), start_s=2.0)
    for t in (2.0, 3.0, 4.0):
        point = reference.at(t)
        assert np.allclose(point.attitude, 0, atol=1e-6)
        assert reference.base_at(t, com)[2] == pytest.approx(0.3 + robot.standing_height, abs=1e-4)
        assert np.allclose(point.velocity, 0, atol=1e-6)
        assert np.allclose(point.angular_acceleration, 0, atol=1e-6)


def test_the_body_tilts_by_a_share_of_the_feets_slope(anymal):
    maker = ReferenceMaker(anymal)
    up = maker.from_contacts(standing_on(anymal, np.array([0.06, 0.06, -0.06, -0.06])), start_s=0.0).at(0.5)
    assert up.attitude[1] == pytest.approx(-0.8 * np.arctan(0.12 / 0.7196), abs=0.01)
    left = maker.from_contacts(standing_on(anymal, np.array([0.05, -0.05, 0.05, -0.05])), start_s=0.0).at(0.5)
    assert left.attitude[0] == pytest.approx(0.8 * np.arctan(0.1 / 0.6024), abs=0.01)


def test_rates_and_accelerations_are_those_of_the_reference(anymal):
    plan = plan_from_gait(GaitTiming.trot(), stones(anymal, 5, np.random.default_rng(3)), start_s=0.2)
    reference = ReferenceMaker(anymal).from_contacts(plan, start_s=0.5)
    h = 1e-4
    for t in np.arange(0.51, 2.5, 0.0377):
        before, now, after = (reference.at(t + k * h) for k in (-1, 0, 1))
        assert np.allclose((after.position - before.position) / (2 * h), now.velocity, atol=1e-5)
        assert np.allclose((after.velocity - before.velocity) / (2 * h), now.acceleration, atol=5e-3)
        turn = Rotation.from_matrix(after.rotation @ before.rotation.T).as_rotvec()
        assert np.allclose(turn / (2 * h), now.angular_velocity, atol=1e-5)
        assert np.allclose(
            (after.angular_velocity - before.angular_velocity) / (2 * h), now.angular_acceleration, atol=2e-2
        )
        roll, pitch, yaw = now.attitude
        assert np.allclose(Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), now.rotation)


@pytest.mark.parametrize("gait", ["trot", "crawl"])
@pytest.mark.parametrize("name", BODIES)
def test_standing_legs_are_neither_too_straight_nor_too_folded(name, gait):
    robot = BODIES[name][0]
    scale = (robot.thigh_length[0] + robot.shank_length[0]) / 0.6125
    maker = ReferenceMaker(robot)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        footholds = stones(robot, 5, rng, stride=0.4 * scale, rise=0.12 * scale, most=0.2 * scale)
        plan = plan_from_gait(getattr(GaitTiming, gait)(), footholds, start_s=0.3)
        for start in np.arange(0.3, plan.end_s, 1.7):
            reference = maker.from_contacts(plan, start_s=start)
            for t in np.arange(start, start + 2.0, 0.02):
                length = spans(maker, plan, reference, t)
                straight = robot.thigh_length + robot.shank_length
                assert np.nanmax(length / straight) < 0.945
                assert np.nanmin(length - maker.legs.shortest) > -0.01


def test_references_made_a_moment_later_go_on_where_the_first_one_was(anymal):
    plan = plan_from_gait(GaitTiming.trot(), stones(anymal, 6, np.random.default_rng(4)), start_s=0.3)
    maker = ReferenceMaker(anymal)
    for start in np.arange(0.5, 3.0, 0.11):
        first, later = maker.from_contacts(plan, start_s=start), maker.from_contacts(plan, start_s=start + 0.02)
        assert np.abs(first.at(start + 0.02).position - later.at(start + 0.02).position).max() < 3e-3
        assert np.abs(first.at(start + 0.02).attitude - later.at(start + 0.02).attitude).max() < 5e-3


def test_height_is_traded_against_tilt_and_place(anymal):
    """One foot 0.3 m low: the least over legs would crouch the whole body until others fold."""
    maker = ReferenceMaker(anymal)
    plan = standing_on(anymal, np.array([0.0, 0.0, 0.0, -0.22]))
    reference = maker.from_contacts(plan, start_s=0.0)
    length = spans(maker, plan, reference, 0.5)
    assert length.max() < 0.575
    assert length.min() > 0.25
    point = reference.at(0.5)
    nominal = 0.8 * np.arctan(0.5 * 0.22 / 0.7196)
    assert abs(point.attitude[1]) > nominal - 0.05


def test_thighs_and_shanks_are_kept_off_the_ground(anymal):
    """A low body over a block between front and hind feet, where a hind shank leans over it."""
    legs = Legs.of(anymal)
    cells = np.zeros((151, 151), np.float32)
    x = (np.arange(151) - 75) * 0.02
    cells[(x > -0.36 + 0.06) & (x < 0.2)] = 0.12
    ground = ground_of(HeightMap(cells, 0.02, np.zeros(2)))
    feet = anymal.stance.copy()
    feet[:, 2] = 0.03
    nominal, standing = np.array([[0, 0, 0.36, 0, 0, 0.0]]), np.ones((1, 4), np.bool_)
    depth = lambda pose: _depth(legs, pose, feet, ground)  # noqa: E731
    offsets = np.zeros((1, 5))
    fit_poses(legs, nominal, feet[None], standing, ground, 0.0, offsets)
    after = nominal[0].copy()
    after[:5] += offsets[0]
    assert depth(nominal[0]) > 0.02
    assert depth(after) < 0.5 * depth(nominal[0])
    lengths = [leg_span(legs, leg, after, feet[leg], np.empty(5)) for leg in range(4)]
    assert max(lengths) < 0.57


def _depth(legs, pose, feet, ground):
    points, depths = np.zeros((4, 3)), np.zeros(4)
    deepest = []
    for leg in range(4):
        leg_points(legs, leg, pose, feet[leg], np.empty((4, 3)), points)
        deepest.append(depths_of(legs, points, ground, depths))
    return max(deepest)


def test_slopes_of_a_leg_are_those_of_its_length(anymal):
    legs, rng = Legs.of(anymal, (0.01, 0.0, 0.02)), np.random.default_rng(0)
    for _ in range(20):
        pose = rng.normal(size=6) * [0.1, 0.1, 0.05, 0.2, 0.2, 1.0] + [0, 0, 0.5, 0, 0, 0]
        leg, slope, unused = int(rng.integers(4)), np.empty(5), np.empty(5)
        foot = pose[:3] + Rotation.from_euler("ZYX", pose[[5, 4, 3]]).apply(
            anymal.stance[leg] + rng.normal(size=3) * 0.1
        )
        leg_span(legs, leg, pose, foot, slope)
        for i in range(5):
            step = 1e-6 * np.eye(6)[i]
            numeric = leg_span(legs, leg, pose + step, foot, unused) - leg_span(legs, leg, pose - step, foot, unused)
            assert numeric / 2e-6 == pytest.approx(slope[i], abs=1e-6)


def test_a_pose_planners_poses_are_filtered_and_fed_forward(anymal):
    now = PoseFilter(np.array([0.55, 0.0, 0.0]), np.zeros(3))
    times = np.arange(0, 3, 0.01)
    ahead = now.ahead([0.60, 0.05, -0.2], times)
    assert np.allclose(ahead[-1, 0], [0.60, 0.05, -0.2], atol=1e-3)
    assert np.abs(ahead[:, 1, 0]).max() <= 0.4
    assert np.abs(ahead[:, 1, 1:]).max() <= 0.9
    assert np.allclose(np.gradient(ahead[:, 0], 0.01, axis=0)[1:-1], ahead[1:-1, 1], atol=0.02)
    assert (np.diff(ahead[:, 0, 0]) >= -1e-9).all()  # critically damped: it does not overshoot
    far = now.ahead([3.0, 0, 0], [1.0])
    assert far[0, 0, 0] == pytest.approx(0.55 + 0.4, abs=0.03)
    later = now.after([0.60, 0.05, -0.2], 0.5)
    assert np.allclose(later.ahead([0.60, 0.05, -0.2], [0.5])[0], now.ahead([0.60, 0.05, -0.2], [1.0])[0], atol=1e-3)
    maker = ReferenceMaker(anymal)
    plan = standing_on(anymal, np.zeros(4))
    posed = maker.from_contacts(
        plan, start_s=0.0, horizon_s=3.0, poses=lambda times: now.ahead([0.50, 0.0, 0.1], times)[:, 0]
    )
    assert posed.base_at(2.0, (0, 0, 0))[2] == pytest.approx(0.50, abs=5e-3)
    assert posed.at(2.0).attitude[1] == pytest.approx(0.1, abs=5e-3)
    with pytest.raises(TrackingError, match="pose filter"):
        now.ahead([np.nan, 0, 0], [0.0])


def test_what_cannot_be_a_reference_is_refused(anymal):
    maker = ReferenceMaker(anymal)
    with pytest.raises(TrackingError, match="body height"):
        ReferenceMaker(anymal, height_m=2.0)
    with pytest.raises(TrackingError, match="centre of mass"):
        ReferenceMaker(anymal, com_offset=(np.nan, 0, 0))
    with pytest.raises(TrackingError, match="20 s"):
        maker.from_contacts(standing_on(anymal, np.zeros(4)), start_s=0.0, horizon_s=99.0)
