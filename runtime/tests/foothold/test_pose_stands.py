import numpy as np
import pytest
from scipy.optimize import minimize

from legtool_runtime.errors import StateError
from legtool_runtime.foothold import Criteria, Gait
from legtool_runtime.foothold.heightmap import extract_heightmap
from legtool_runtime.foothold.pose import Pose, PosePlanner
from legtool_runtime.foothold.pose_kernels import objective
from legtool_runtime.foothold.pose_settings import PoseSettings
from legtool_runtime.foothold.pose_stands import FREE, PENALTY, beyond_stands, model_stands, stands_of
from legtool_runtime.legs import Legs
from legtool_runtime.rotations import from_angles, place
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.reach import leg_span

TWIST = (0.3, 0.02, 0.0, 0.0, 0.0, 0.2)
GAIT = Gait(0.2, 1.4, 0.55)
NO_FEET = np.full((4, 3), np.nan)


@pytest.fixture(scope="module")
def criteria(robots):
    return Criteria(robots[0])


def stairs():
    x = (np.arange(200) - 60) * 0.02
    h = np.clip(np.floor((x - 0.6) / 0.25) + 1, 0, 5) * 0.1
    return HeightMap(np.repeat(h[:, None], 90, axis=1), 0.02, np.array([x.mean(), 0.0]))


def beyond(planner, pose, feet, base, yaw):
    """Farthest that a standing leg is beyond its bounds, now and 0.3 s later [m], by the tracker's own kinematics."""
    robot, legs, worst = planner.robot, Legs.of(planner.robot), -1.0
    for later in (0.0, 0.3):
        turn = yaw + TWIST[5] * later
        half = yaw + 0.5 * TWIST[5] * later
        way = from_angles(0, 0, half)[:2, :2] @ np.array(TWIST[:2]) * later
        at = np.array([base[0] + way[0], base[1] + way[1], pose.height, pose.roll, pose.pitch, turn])
        for leg in np.flatnonzero(~np.isnan(feet[:, 0])):
            span = leg_span(legs, leg, at, feet[leg], np.empty(5))
            hip = place(robot.hips[leg], pose.roll, pose.pitch, turn, at[:3])
            knee = np.sqrt(np.sum((feet[leg] - hip) ** 2) - robot.abduction_offset[leg] ** 2)
            assert span == pytest.approx(knee, abs=1e-9)
            worst = max(worst, span - planner.settings.stretch * legs.reach[leg], legs.shortest[leg] - span)
    return worst


def spread(rng, robot, base, yaw, elevation, far):
    """(4, 3) feet around the rest positions, on the ground of the map; one of them swings."""
    feet = NO_FEET.copy()
    for leg in rng.permutation(4)[:3]:
        x, y, _ = place(robot.stance[leg] + [*rng.uniform(-far, far, 2), 0.0], 0.0, 0.0, yaw, (*base, 0.0))
        feet[leg] = x, y, float(extract_heightmap(elevation, (x, y), yaw=0.0)[16, 16]) + robot.foot_radius
    return feet


def test_on_stairs_every_standing_leg_keeps_its_bounds_where_without_them_it_does_not(criteria):
    rng, planner = np.random.default_rng(0), PosePlanner(criteria, PoseSettings(stretch=0.975))
    broken = 0
    for _ in range(12):
        base, yaw = (rng.uniform(0.3, 1.0), rng.uniform(-0.1, 0.1)), rng.uniform(-0.3, 0.3)
        feet = spread(rng, criteria.robot, base, yaw, stairs(), 0.12)
        how = dict(base_position=base, yaw=yaw, base_twist=TWIST, gait=GAIT)
        free, bound = (planner.plan(stairs(), **how, standing=standing).poses[0] for standing in (None, feet))
        broken += beyond(planner, free, feet, base, yaw) > 0.01
        assert beyond(planner, bound, feet, base, yaw) < 1e-3
    assert broken >= 4


def test_where_no_leg_is_at_its_bounds_the_pose_is_the_same(criteria):
    planner = PosePlanner(criteria)
    feet = criteria.robot.stance + np.array([0.1, 0.0, criteria.robot.standing_height])
    level = HeightMap(np.zeros((150, 120)), 0.02, np.zeros(2))
    how = dict(base_position=(0.1, 0.0), yaw=0.0, base_twist=(0.1, 0, 0, 0, 0, 0), gait=GAIT)
    for ground in (level, stairs()):
        free = planner.plan(ground, **how)
        assert beyond(planner, free.poses[0], feet, (0.1, 0.0), 0.0) < 0
        bound = planner.plan(ground, **how, standing=feet)
        for one, other in zip(free.poses, bound.poses, strict=True):
            assert (other.height, other.roll, other.pitch) == pytest.approx((one.height, one.roll, one.pitch), abs=1e-4)
        nobody = planner.plan(ground, **how, standing=NO_FEET)
        assert nobody.poses[0].height == free.poses[0].height and nobody.objective == free.objective


def random_stands(rng, planner, far):
    feet = planner.robot.stance + rng.uniform(-far, far, (4, 3)) + [0, 0, planner.robot.standing_height]
    how = dict(base_position=(0.0, 0.0), yaw=0.0, base_twist=TWIST, reference=0.0, stretch=0.975, ahead_s=0.3)
    return stands_of(planner.legs, feet, **how)


def test_the_penaltys_slope_is_that_of_differences(criteria):
    rng, planner = np.random.default_rng(1), PosePlanner(criteria)
    bent = 0
    for _ in range(30):
        stands = random_stands(rng, planner, 0.15)
        pose, gradient, matrix = np.array([0.62, *rng.uniform(-0.3, 0.3, 2)]), np.zeros(3), np.zeros((3, 3))
        value = model_stands(stands, pose, gradient, matrix)
        assert value == pytest.approx(PENALTY * beyond_stands(stands, pose))
        step = 1e-6 * np.eye(3)
        slope = [(beyond_stands(stands, pose + d) - beyond_stands(stands, pose - d)) / 2e-6 for d in step]
        assert gradient == pytest.approx(-PENALTY * np.array(slope), rel=1e-4, abs=1e-2)
        bent += value > 0
    assert bent > 20


def by_slsqp(problem, stands, start):
    """The best objective that SciPy finds with the legs' bounds as constraints; -inf where it keeps not all."""

    def room(u):
        hips = place(stands[:, :3], u[1], u[2], 0.0, (0.0, 0.0, u[0]))
        way = np.linalg.norm(hips - stands[:, 3:6], axis=1)
        return np.concatenate([stands[:, 7] - way, way - stands[:, 6]])

    free = problem._replace(low=problem.low - 9, high=problem.high + 9)
    found = minimize(
        lambda u: -objective(free, u[None]), start, method="SLSQP",
        bounds=list(zip(problem.low[0], problem.high[0], strict=True)), constraints={"type": "ineq", "fun": room},
    )  # fmt: skip
    return -found.fun if room(found.x).min() > -1e-6 else -np.inf


def test_the_search_with_standing_legs_reaches_a_reference_solver(criteria):
    rng = np.random.default_rng(2)
    planner = PosePlanner(criteria, PoseSettings(horizons=1))
    z = np.linspace(planner.basis.low, planner.basis.high, 31)
    compared = 0
    for _ in range(40):
        middle, width = rng.uniform(0.45, 0.65, (1, 4, 1)), rng.uniform(0.06, 0.15, (1, 4, 1))
        weights = planner.basis.fit(z, np.maximum(600 * (1 - ((z - middle) / width) ** 2), 0))
        stands = random_stands(rng, planner, 0.06)
        plan = planner.optimise(weights, [0.0], stands=stands)
        pose = np.array([plan.poses[0].height, plan.poses[0].roll, plan.poses[0].pitch])
        problem, guess = planner.problem(weights, [0.0])
        best = max(by_slsqp(problem, stands, start) for start in (guess[0], pose))
        if best > -np.inf:
            compared += 1
            assert plan.objective >= best - 0.01 * abs(best)
            assert beyond_stands(stands, pose) < 1e-6
    assert compared > 15


def test_legs_are_judged_below_the_trunk_as_it_is_now(criteria):
    class Watch:
        robot = criteria.robot

        def weights(self, tuples):
            asked.extend(tuples)
            return np.ones((len(tuples), 30))

    planner, now = PosePlanner(criteria, network=Watch()), Pose(0.7, 0.1, -0.25, np.zeros(4), 0.0)
    how = dict(base_position=(0.4, 0.0), yaw=0.2, base_twist=TWIST, gait=GAIT)
    for given, expected in (
        ({}, (0.0, 0.0)),
        ({"previous": now}, (0.1, -0.25)),
        ({"previous": now, "attitude": (0.02, 0.3)}, (0.02, 0.3)),
    ):
        asked = []
        planner.plan(stairs(), **how, **given)
        assert len(asked) == 8 and {(t.roll, t.pitch) for t in asked} == {expected}
        # Maps lie below the hips of that trunk.
        hip = place(criteria.robot.hips[0], *expected, 0.2, (0.4, 0.0, 0.0))
        cut = extract_heightmap(stairs(), hip[:2], yaw=0.2)
        assert np.ptp(asked[0].heights - cut) < 1e-6


def test_feet_that_cannot_be_are_told(criteria):
    planner = PosePlanner(criteria)
    how = dict(base_position=(0.0, 0.0), yaw=0.0, base_twist=TWIST, reference=0.0, stretch=1.0, ahead_s=0.0)
    for feet in (np.zeros((2, 3)), np.full((4, 3), np.inf)):
        with pytest.raises(StateError, match=r"standing feet .*expected \(4, 3\) in metres, NaN for legs that do not"):
            stands_of(planner.legs, feet, **how)
    assert stands_of(planner.legs, NO_FEET, **how).shape == FREE.shape
