import warnings

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, minimize

from legtool_runtime.errors import StateError
from legtool_runtime.foothold import Criteria, Gait
from legtool_runtime.foothold.basis import RadialBasis
from legtool_runtime.foothold.pose import Pose, PosePlanner, below_hips, hips_above, terrain_pose
from legtool_runtime.foothold.pose_kernels import gain, objective, read
from legtool_runtime.foothold.pose_settings import COSTS, PoseSettings
from legtool_runtime.terrain.elevation import HeightMap

FORWARD = (0.2, 0.0, 0.0, 0.0, 0.0, 0.0)
GAIT = Gait(0.14, 1.4, 0.55)


@pytest.fixture(scope="module")
def criteria(robots):
    return Criteria(robots[0])


def stairs(steps=2):
    x = (np.arange(200) - 60) * 0.02
    h = np.clip(np.floor((x - 0.6) / 0.25) + 1, 0, steps) * 0.1
    return HeightMap(np.repeat(h[:, None], 90, axis=1), 0.02, np.array([x.mean(), 0.0]))


def random_weights(rng, basis, horizons):
    """Weights of functions like those of real terrain: a hump per leg, some flat, some absent."""
    z = np.linspace(basis.low, basis.high, 31)
    middle, width, top = (rng.uniform(a, b, (horizons, 4, 1)) for a, b in ((0.4, 0.65), (0.04, 0.15), (0, 800)))
    counts = np.maximum(top * (1 - ((z - middle) / width) ** 2), 0) * (rng.random((horizons, 4, 1)) > 0.1)
    return basis.fit(z, counts)


def by_scipy(problem, guess):
    """The reference: SciPy's trust-region interior point; its objective, None where its answer breaks a limit."""
    h = len(guess)
    free = problem._replace(low=problem.low - 9, high=problem.high + 9, change=problem.change + 9)
    limits = []
    if h > 1:
        shift = np.array([problem.references[1] - problem.references[0], 0, 0])
        matrix = np.hstack([-np.eye(3), np.eye(3)])
        limits = [LinearConstraint(matrix, -problem.change - shift, problem.change - shift)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = minimize(
            lambda u: -objective(free, u.reshape(h, 3)),
            guess.ravel(),
            method="trust-constr",
            bounds=Bounds(problem.low.ravel(), problem.high.ravel()),
            constraints=limits,
            options={"maxiter": 200},
        )
    value = objective(problem, np.clip(found.x.reshape(h, 3), problem.low, problem.high))
    return value if np.isfinite(value) else None


def test_three_functions_have_the_papers_width_and_centres():
    basis = RadialBasis(count=3, width=1.0)
    assert basis.centers == pytest.approx([0.2, 0.5, 0.8])
    assert basis.sigma == pytest.approx(0.13, abs=0.003)
    assert basis.functions(0.35)[:2] == pytest.approx([0.5, 0.5])


def test_wider_functions_ripple_less_over_a_constant():
    z, inside = np.linspace(0.2, 0.8, 31), np.linspace(0.25, 0.75, 500)

    def ripple(width):
        basis = RadialBasis(width=width)
        return np.ptp(basis.functions(inside) @ basis.fit(z, np.full(31, 600.0)))

    assert ripple(1.0) > 60
    assert ripple(2.0) < 12


def test_hip_heights_are_those_of_the_rotated_hips(robots):
    pose = np.array([0.6, 0.1, -0.2])
    cb, sb, cg, sg = np.cos(0.1), np.sin(0.1), np.cos(-0.2), np.sin(-0.2)
    ry = np.array([[cg, 0, sg], [0, 1, 0], [-sg, 0, cg]])
    rx = np.array([[1, 0, 0], [0, cb, -sb], [0, sb, cb]])
    assert hips_above(robots[0].hips, pose) == pytest.approx(0.6 + (robots[0].hips @ (ry @ rx).T)[:, 2])


@pytest.mark.parametrize("cost", COSTS)
def test_costs_are_those_of_the_paper(criteria, cost):
    planner = PosePlanner(criteria, PoseSettings(cost=cost, horizons=1))
    weights = random_weights(np.random.default_rng(0), planner.basis, 1)
    problem, _ = planner.problem(weights, [0.0])
    pose, m = np.array([0.62, 0.05, -0.1]), planner.settings.margin_m
    z = hips_above(criteria.robot.hips, pose)

    def f(shift):
        return np.einsum("le,le->l", planner.basis.functions(z + shift), weights[0]) / 1089

    least = np.min([f(shift) for shift in np.linspace(-m, m, 41)], axis=0)
    expected = {
        "sum": (f(0) ** 2).sum(),
        "product": (f(0) ** 2).prod(),
        "integral": ((m * (f(-m) + f(m))) ** 2).sum() / (2 * m) ** 2,  # equation 22, in shares of its width
        "smoothed": (np.mean([f(s * m) for s in (-1, -0.5, 0, 0.5, 1)], axis=0) ** 2).sum(),
        # Of each leg the mean of what it has and of the least around; of all the power mean that the worst leg rules.
        "robust": np.mean((np.maximum((f(0) + least) / 2, 0) + 5e-3) ** -2.0) ** -0.5,
    }
    tolerance = 0.03 if cost == "robust" else 1e-3  # its least values are taken between steps of the table
    assert gain(problem, 0, *pose) == pytest.approx(expected[cost], rel=tolerance, abs=1e-7)


def test_tables_are_read_smoothly(criteria):
    planner = PosePlanner(criteria, PoseSettings(cost="sum", horizons=1))
    weights = random_weights(np.random.default_rng(1), planner.basis, 1)
    problem, _ = planner.problem(weights, [0.0])
    for z in np.linspace(0.21, 0.79, 50):
        place = (z - problem.first) / problem.step
        got = read(problem.values[0, 0], problem.slopes[0, 0], place, problem.step)
        assert got == pytest.approx(float(planner.basis.functions(z) @ weights[0, 0]) / 1089, abs=1e-5)


def compare(criteria, problems, seed):
    rng = np.random.default_rng(seed)
    planners = [PosePlanner(criteria, PoseSettings(cost=c, horizons=h)) for c in COSTS for h in (1, 2)]
    compared = 0
    for n in range(problems):
        planner = planners[n % len(planners)]
        h = planner.settings.horizons
        weights, references = random_weights(rng, planner.basis, h), np.cumsum(rng.normal(scale=0.05, size=h))
        previous = None
        if n % 3:
            previous = Pose(references[0] + rng.uniform(0.5, 0.7), *rng.uniform(-0.2, 0.2, 2), np.zeros(4), 0.0)
        plan = planner.optimise(weights, references, previous=previous, travelled_m=0.05)
        reference = by_scipy(*planner.problem(weights, references, previous=previous, travelled_m=0.05))
        if reference is not None:
            compared += 1
            assert plan.objective >= reference - 0.01 * abs(reference) - 1e-6, (n, planner.settings.cost, h)
    return compared


def test_the_search_reaches_the_reference_solver(criteria):
    assert compare(criteria, 20, seed=0) > 10


@pytest.mark.slow
def test_the_search_reaches_the_reference_solver_on_thousands_of_problems(criteria):
    assert compare(criteria, 2000, seed=1) > 1500


def test_poses_keep_bounds_and_limits_of_change(criteria):
    rng = np.random.default_rng(3)
    planner = PosePlanner(criteria)
    s, previous = planner.settings, None
    for _ in range(30):
        weights = random_weights(rng, planner.basis, 2)
        plan = planner.optimise(weights, [0.0, 0.05], previous=previous, travelled_m=0.05)
        first, second = plan.poses
        assert abs(first.roll) <= s.angle and abs(first.pitch) <= s.angle
        assert abs(second.height - first.height) <= s.height_per_m * s.shift_m + 1e-9
        if previous is not None:
            assert abs(first.height - previous.height) <= s.height_per_m * 0.05 + 1e-9
            assert abs(first.pitch - previous.pitch) <= s.pitch_per_m * 0.05 + 1e-9
        previous = first


def test_on_flat_ground_the_robot_stands_level(criteria):
    level = HeightMap(np.zeros((120, 90)), 0.02, np.zeros(2))
    for cost in COSTS:
        plan = PosePlanner(criteria, PoseSettings(cost=cost)).plan(
            level, base_position=(0, 0), yaw=0.0, base_twist=(0.0,) * 6, gait=Gait(0.0)
        )
        assert abs(plan.poses[0].roll) < 0.03 and abs(plan.poses[0].pitch) < 0.1
        assert (plan.poses[0].safe > 500).all()


def test_before_a_stair_the_robot_raises_its_front(criteria):
    planner = PosePlanner(criteria, threads=2)
    plan = planner.plan(stairs(), base_position=(0.45, 0.0), yaw=0.0, base_twist=FORWARD, gait=GAIT)
    assert plan.poses[0].pitch < -0.05  # nose up
    assert (plan.poses[0].safe > 50).all()
    alone = PosePlanner(criteria).plan(stairs(), base_position=(0.45, 0.0), yaw=0.0, base_twist=FORWARD, gait=GAIT)
    assert alone.poses[0].height == plan.poses[0].height


def test_heights_are_measured_above_the_terrain_below(criteria):
    planner = PosePlanner(criteria)
    one = planner.plan(stairs(), base_position=(0.3, 0.0), yaw=0.0, base_twist=FORWARD, gait=GAIT)
    high = stairs()
    raised = HeightMap(high.heights + 5.0, 0.02, high.center)
    other = planner.plan(raised, base_position=(0.3, 0.0), yaw=0.0, base_twist=FORWARD, gait=GAIT)
    assert other.poses[0].height == pytest.approx(one.poses[0].height + 5.0, abs=0.01)


def test_the_baseline_lies_in_the_plane_of_its_footholds(robots):
    feet = robots[0].stance.copy()
    feet[:, 2] = 0.3 * feet[:, 0] - 0.1 * feet[:, 1] + 1.0
    height, roll, pitch = terrain_pose(feet, yaw=0.0, height=0.6)
    assert height == pytest.approx(1.6)
    hips = np.stack([feet[:, 0], feet[:, 1], np.zeros(4)], axis=1)
    above = hips_above(hips, (height, roll, pitch)) - height
    assert above == pytest.approx((feet[:, 2] - 1.0) * np.cos(pitch), abs=0.01)


def test_nothing_known_below_is_told(criteria):
    nothing = HeightMap(np.full((100, 100), np.nan), 0.02, np.zeros(2))
    with pytest.raises(StateError, match="nothing is known"):
        PosePlanner(criteria).plan(nothing, base_position=(0, 0), yaw=0.0, base_twist=FORWARD, gait=GAIT)
    with pytest.raises(StateError, match="expected one of sum, product"):
        PoseSettings(cost="best")


def test_a_level_out_of_reach_ahead_does_not_draw_the_trunk_down(criteria):
    x = (np.arange(200) - 60) * 0.02
    level = HeightMap(np.zeros((200, 90), np.float32), 0.02, np.array([x.mean(), 0.0]))
    pit = HeightMap(np.where(x > 0.55, -1.5, 0.0)[:, None] * np.ones((1, 90)), 0.02, np.array([x.mean(), 0.0]))
    planner = PosePlanner(criteria)
    heights = [
        planner.plan(m, base_position=(0.0, 0.0), yaw=0.0, base_twist=FORWARD, gait=GAIT).poses[0].height
        for m in (level, pit)
    ]
    assert heights[1] == pytest.approx(heights[0], abs=0.06)


def test_coarse_counts_lead_to_poses_with_as_many_safe_footholds(criteria):
    elevation, planners = stairs(), (PosePlanner(criteria), PosePlanner(criteria, coarse=True))
    least = np.empty((2, 12))
    for k, planner in enumerate(planners):
        for n, x in enumerate(np.linspace(0.0, 0.9, 12)):
            at = {"base_position": (float(x), 0.0), "yaw": 0.0, "base_twist": FORWARD}
            pose = planner.plan(elevation, gait=GAIT, **at).poses[0]
            maps, _ = planner.heightmaps(elevation, **at, attitude=(pose.roll, pose.pitch))
            tuples = below_hips(maps, base_twist=FORWARD, gait=GAIT, attitude=(pose.roll, pose.pitch))[0]
            hips = hips_above(criteria.robot.hips, (pose.height - pose.reference, pose.roll, pose.pitch))
            least[k, n] = min(criteria.counts(t, [z])[0] for t, z in zip(tuples, hips, strict=True))
    assert least[0].min() > 100
    assert least[1].mean() > 0.95 * least[0].mean() and least[1].min() > 0.85 * least[0].min()
