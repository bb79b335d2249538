from dataclasses import replace

import numpy as np
import pytest

from legtool_runtime.errors import LegtoolError, RobotError, StateError
from legtool_runtime.foothold import Criteria, CriteriaSettings, Gait, Tuple, hip_heights
from legtool_runtime.foothold.criteria.criteria import FC, KF, LC, MARGIN, TR, UNKNOWN
from legtool_runtime.foothold.gait import hip_velocity
from legtool_runtime.rotations import place

#: How far from a criterion's threshold a cell lies on which kernels and reference may differ: slope; rad or m; m; m.
TOLERANCE = {TR: 1e-3, KF: 0.02, LC: 0.012, FC: 0.006}
NAMES = {TR: "TR", LC: "LC", KF: "KF", FC: "FC"}
FORWARD = (0.3, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def criteria(robots):
    return [Criteria(robot) for robot in robots]


def walking(heights, **changes):
    """The front left leg's tuple of a robot that walks forward."""
    return Tuple(heights, **{"leg": 0, "hip_height": 0.56, "base_twist": FORWARD, "gait": Gait(), **changes})


def stairs(rise=0.1, go=0.25, ahead=0.1):
    x = (np.arange(33) - 16) * 0.02
    h = np.repeat(np.floor((x - ahead) / go + 1)[:, None] * rise, 33, axis=1)
    return (h - h[16, 16]).astype(np.float32)


def agreement(criteria, slow, terrains, cells, seed, tilt=0.0):
    """Compare kernels and reference; returns compared and differing cells per criterion, and those in doubt."""
    rng = np.random.default_rng(seed)
    compared, differing, doubtful = dict.fromkeys(NAMES, 0), dict.fromkeys(NAMES, 0), 0
    for n in range(terrains):
        judge = criteria[n % len(criteria)]
        case = slow.case(rng, judge.robot, tilt)
        try:
            found = judge.evaluate(Tuple(**case))
        except StateError:  # a random block reaches above the hip
            continue
        known = np.argwhere(~np.isnan(case["heights"]))
        chosen = rng.choice(known, cells, replace=False)
        for (ix, iy), options in zip(chosen, slow.judge_all(judge.robot, judge.settings, case, chosen), strict=True):
            doubtful += len(options) > 1
            # Where no leg reaches there is no leg to collide.
            told = [
                {
                    bit: (bool(found.mask(bit)[ix, iy]), margins[name])
                    for bit, name in NAMES.items()
                    if bit != LC or margins["KF"] >= TOLERANCE[KF]
                }
                for margins in options
            ]
            fitting = [
                each
                for each in told
                if all(ok == (m >= 0) or abs(m) <= TOLERANCE[bit] for bit, (ok, m) in each.items())
            ]
            assert fitting, (n, ix, iy, told)
            for bit, (ok, margin) in fitting[0].items():
                compared[bit] += 1
                differing[bit] += ok != (margin >= 0)
    return compared, differing, doubtful


@pytest.mark.parametrize(("tilt", "seed"), [(0.0, 3), (0.4, 13)])
def test_kernels_agree_with_the_plain_reference_but_near_thresholds(criteria, slow, tilt, seed):
    compared, differing, doubtful = agreement(criteria, slow, terrains=40, cells=4, seed=seed, tilt=tilt)
    assert doubtful <= 0.5 * compared[TR]
    for bit, name in NAMES.items():
        assert compared[bit] > 40
        assert differing[bit] <= 0.04 * compared[bit], name


@pytest.mark.slow
@pytest.mark.parametrize(("tilt", "seed"), [(0.0, 4), (0.4, 14)])
def test_kernels_agree_with_the_plain_reference_on_thousands_of_terrains(criteria, slow, tilt, seed):
    compared, differing, doubtful = agreement(criteria, slow, terrains=4000, cells=2, seed=seed, tilt=tilt)
    print(f"compared {compared}, differing near a threshold {differing}, lift-off in doubt {doubtful}")
    for bit, name in NAMES.items():
        assert differing[bit] <= 0.03 * compared[bit], name


def test_the_swing_is_judged_from_lift_off_on(criteria):
    # The hip sinks: at lift-off it was too high for the leg, a little later, the foot risen, it is not.
    common = dict(leg=0, hip_height=0.5, base_twist=(0.1, 0.0, -0.4, 0.0, 0.0, 0.0), nominal=(0.025, 0.0))
    whole, later = (
        criteria[0].evaluate(Tuple(np.zeros((33, 33)), gait=Gait(0.1, 1.0, 0.5, left), **common))
        for left in (10.0, 0.4)
    )
    assert not whole.mask(KF).any()
    assert later.mask(KF)[16, 16]


def test_the_foot_is_taken_to_have_stood_where_the_leg_can_lift_off(criteria):
    # A hind leg with its knee in front, one step behind right below a riser: from there its shank would meet the edge.
    h = np.zeros((33, 33))
    h[12:] = 0.1
    gait, twist = Gait(0.24, 1.4, 0.55), (0.3, 0.0, 0.0, 0.0, 0.0, 0.0)
    t = Tuple(h, leg=2, hip_height=0.66, base_twist=twist, gait=gait, nominal=(0.06, 0.0))
    assert criteria[0].evaluate(t).count > 50


def test_safe_is_the_conjunction_eroded_by_the_uncertainty_radius(robots, slow):
    robot = robots[0]
    for radius in (0.0, 0.02, 0.045):
        judge = Criteria(robot, CriteriaSettings(uncertainty_m=radius))
        rng = np.random.default_rng(0)
        reach = np.argwhere(np.hypot(*np.indices((5, 5)) - 2) * 0.02 <= radius + 1e-9) - 2
        for _ in range(20):
            case = slow.case(rng, robot)
            found = judge.evaluate(Tuple(**case))
            both = np.logical_and.reduce([found.mask(bit) for bit in NAMES])
            padded = np.pad(both, 2)
            eroded = np.logical_and.reduce([padded[2 + i : 35 + i, 2 + j : 35 + j] for i, j in reach])
            assert np.array_equal(found.safe, eroded)
            assert np.array_equal(found.reasons == MARGIN, both & ~eroded)


@pytest.mark.parametrize("tilt", [0.0, 0.35])
def test_counts_are_those_of_each_hip_height_alone(criteria, slow, tilt):
    rng = np.random.default_rng(1)
    for n in range(10):
        judge = criteria[n % 2]
        case = slow.case(rng, judge.robot, tilt)
        case["heights"] = np.minimum(case["heights"], 0.1)
        t, heights = Tuple(**case), hip_heights(judge.robot)
        alone = [judge.evaluate(replace(t, hip_height=z)).count for z in heights]
        assert judge.counts(t, heights).tolist() == alone


def test_counts_are_none_with_the_hip_below_the_ground(criteria):
    t = Tuple(np.full((33, 33), 0.3), leg=0, base_twist=FORWARD, gait=Gait())
    assert criteria[0].counts(t, [0.1, 0.2]).tolist() == [0, 0]


def test_flat_ground_is_safe_around_the_nominal_foothold(criteria):
    found = criteria[0].evaluate(walking(np.zeros((33, 33)), nominal=(0.05, 0.0)))
    assert found.safe[10:23, 10:23].all()
    assert found.explain(16, 16) == "it is safe"


def test_edges_are_rough_and_treads_are_smooth(criteria):
    h = stairs()
    found = criteria[0].evaluate(walking(h))
    rough = ~found.mask(TR)[1:-1, 16]
    edge = np.diff(h[:, 16]) > 0.05
    assert np.array_equal(rough, (edge[:-1] | edge[1:]))
    assert "too rough" in found.explain(1 + int(np.argmax(rough)), 16)


def test_a_wall_in_the_way_of_the_swing_is_told_as_its_collision(criteria):
    h = np.zeros((33, 33))
    h[14:16] = 0.3
    found = criteria[0].evaluate(walking(h, gait=Gait(step_length_m=0.3), nominal=(0.0, 0.0)))
    assert not found.mask(FC)[20:26, 16].any()
    assert "swing foot" in found.explain(22, 16)


def test_a_swing_that_is_nearly_over_collides_with_less(criteria):
    h = np.zeros((33, 33))
    h[8:10] = 0.25
    early, late = (
        criteria[0].evaluate(walking(h, gait=Gait(0.3, 1.4, 0.55, left), nominal=(0.0, 0.0))) for left in (10.0, 0.05)
    )
    assert late.mask(FC)[16, 16] and not early.mask(FC)[16, 16]


def test_footholds_out_of_reach_or_beyond_joint_limits_are_told(criteria):
    low, high = (criteria[0].evaluate(walking(np.zeros((33, 33)), hip_height=z)) for z in (0.25, 0.8))
    assert not low.mask(KF).any() and not high.mask(KF).any()
    assert "cannot reach" in high.explain(16, 16)


def test_a_shank_leaning_over_a_riser_collides(robots):
    # The foot stands below a block that the shank, thick as a thigh, must lean over as the hip moves on.
    robot = robots[1]
    h = np.zeros((33, 33))
    h[:10] = 0.12
    t = walking(h, base_twist=(0.0,) * 6, gait=Gait(0.0, 1.4, 0.55, 0.0), nominal=(0.0, 0.09))
    found = Criteria(robot).evaluate(t)
    assert not found.mask(LC)[10:12, 16].any()
    assert found.mask(LC)[22, 16]


@pytest.mark.parametrize("tilt", [0.0, 0.35])
def test_left_and_right_legs_mirror_each_other(criteria, slow, tilt):
    rng = np.random.default_rng(5)
    for _ in range(10):
        case = slow.case(rng, criteria[0].robot, tilt)
        case["leg"] = 0
        mirrored = dict(case, leg=1, heights=case["heights"][:, ::-1].copy())
        vx, vy, vz, wx, wy, wz = case["base_twist"]
        mirrored["base_twist"] = (vx, -vy, vz, -wx, wy, -wz)
        mirrored["roll"] = -case.get("roll", 0.0)
        if case["nominal"] is not None:
            mirrored["nominal"] = (case["nominal"][0], -case["nominal"][1])
        one = criteria[0].evaluate(Tuple(**case)).reasons
        other = criteria[0].evaluate(Tuple(**mirrored)).reasons[:, ::-1]
        assert (one != other).mean() < 0.01  # single precision, at thresholds


def test_unknown_cells_are_unsafe_and_so_is_what_is_beside_them(criteria):
    h = np.zeros((33, 33))
    h[16, 18] = np.nan
    found = criteria[0].evaluate(walking(h))
    assert found.reasons[16, 18] & UNKNOWN
    assert "unknown" in found.explain(16, 18)
    assert not found.safe[15:18, 17:20].any()
    assert found.mask(FC)[16, 16]
    nowhere = walking(np.full((33, 33), np.nan))
    assert criteria[0].counts(nowhere, [0.5]).tolist() == [0]
    assert (criteria[0].evaluate(nowhere).reasons & UNKNOWN).all()


def test_bad_input_is_told_in_words(criteria):
    judge, flat = criteria[0], np.zeros((33, 33))
    with pytest.raises(StateError, match="above the ground below the hip"):
        judge.evaluate(walking(flat + 0.6))
    with pytest.raises(StateError, match="above the ground below the hip"):
        judge.is_safe(walking(flat + 0.6), (16, 16))
    without = Tuple(flat, leg=0, base_twist=FORWARD, gait=Gait())
    for ask in (judge.evaluate, judge.coarse, judge.lift_off):
        with pytest.raises(StateError, match="the tuple has no hip height"):
            ask(without)
    with pytest.raises(StateError, match="hip heights: one is not finite"):
        judge.counts(without, [0.5, np.nan])
    with pytest.raises(StateError, match=r"duty_factor is 1\.2, expected 0\.1 to 0\.95"):
        Gait(duty_factor=1.2)
    with pytest.raises(LegtoolError, match="slope_mean"):
        CriteriaSettings(slope_mean=-1)


def test_a_robot_without_joint_limits_is_told_how_to_say_so(robots):
    free = np.broadcast_to([-np.inf, np.inf], (4, 3, 2))
    with pytest.raises(RobotError, match=r"joint_limits holds .* no limit, give -3\.1416 and 3\.1416"):
        replace(robots[0], joint_limits=free)
    turning = Criteria(replace(robots[0], joint_limits=np.broadcast_to([-3.1416, 3.1416], (4, 3, 2))))
    t = walking(np.zeros((33, 33)))
    assert turning.evaluate(t).mask(KF).sum() > Criteria(robots[0]).evaluate(t).mask(KF).sum()


@pytest.mark.parametrize("tilt", [0.0, 0.35])
def test_one_cell_alone_is_judged_as_among_all(criteria, slow, tilt):
    rng = np.random.default_rng(7)
    for n in range(30):
        judge = criteria[n % 2]
        case = slow.case(rng, judge.robot, tilt)
        case["heights"] = np.minimum(case["heights"], 0.3)
        t = Tuple(**case)
        safe = judge.evaluate(t).safe
        for ix, iy in rng.integers(0, 33, (4, 2)):
            assert judge.is_safe(t, (ix, iy)) == safe[ix, iy]


@pytest.mark.parametrize("tilt", [0.0, 0.35])
def test_a_coarse_check_sees_nearly_the_same_and_no_cell_that_is_rough_or_unknown(criteria, slow, tilt):
    rng = np.random.default_rng(8)
    seen, missed, wrong = 0, 0, 0
    for n in range(200):
        judge = criteria[n % 2]
        case = slow.case(rng, judge.robot, tilt)
        case["heights"] = np.minimum(case["heights"], 0.3)
        t = Tuple(**case)
        found, seems = judge.evaluate(t), judge.coarse(t)
        assert not (seems & ~found.mask(TR)).any()
        seen += found.count
        missed += int((found.safe & ~seems).sum())
        wrong += int((seems & ~found.safe).sum())
    assert seen > 10_000 and missed < 0.01 * seen and wrong < 0.05 * seen
    for hip_height in (3.0, -3.0):
        assert judge.coarse(replace(t, hip_height=hip_height)).sum() == 0


@pytest.mark.parametrize("tilt", [0.0, 0.35])
def test_a_coarse_count_over_hip_heights_tells_about_how_many_footholds_are_safe(criteria, slow, tilt):
    rng = np.random.default_rng(9)
    errors = []
    for n in range(100):
        judge = criteria[n % 2]
        t, hips = replace(Tuple(**slow.case(rng, judge.robot, tilt)), nominal=None), hip_heights(judge.robot)
        exact = judge.counts(t, hips)
        about, before = judge.coarse_counts(t, hips)
        # Every other cell is judged, and the erosion only takes away.
        assert (before <= (33 * 33 + 1) / 2).all() and (about <= 2 * before).all()
        if exact.any():
            errors.append(np.abs(about - exact).mean() / exact.mean())
    assert len(errors) > 60 and np.median(errors) < 0.15
    below = judge.coarse_counts(walking(np.zeros((33, 33))), [-0.1, 0.5])
    assert below[:, 0].tolist() == [0, 0] and (below[:, 1] > 100).all()
    unknown = judge.coarse_counts(walking(np.full((33, 33), np.nan)), [0.5])
    assert unknown.tolist() == [[0], [0]]


def test_the_foot_lifts_off_one_step_behind_on_smooth_ground(criteria):
    how = dict(hip_height=0.6, gait=Gait(0.24, 1.4, 0.55), nominal=(0.06, 0.0))
    flat = criteria[0].lift_off(walking(np.zeros((33, 33)), **how))
    assert flat == pytest.approx([-0.24, 0, 0.02], abs=0.011)
    edge = np.zeros((33, 33))
    edge[:6] = 0.1  # right below the step behind
    x, _, z = criteria[0].lift_off(walking(edge, **how))
    assert abs(x + 0.21) > 0.025 and z == pytest.approx(edge[round(x / 0.02) + 16, 16] + 0.02)


@pytest.mark.parametrize("pitch", [-0.3, 0.2])
def test_a_pitched_trunk_takes_as_much_of_the_thighs_range(criteria, pitch):
    # Exactly so for feet that need no abduction: in the plane of thigh and shank, where both turn about one axis.
    judge = criteria[0]
    limits = judge.robot.joint_limits.copy()
    limits[:, 1] += pitch
    shifted = Criteria(replace(judge.robot, joint_limits=limits))
    differ = 0
    for leg in (0, 2):
        for height in (0.4, 0.5, 0.6):
            # Late in the swing, so that the place of lift-off is in this plane too.
            t = walking(stairs(), leg=leg, hip_height=height, gait=Gait(0.2, 1.4, 0.55, 0.15))
            pitched, level, other = (
                found.evaluate(a) for found, a in ((judge, replace(t, pitch=pitch)), (judge, t), (shifted, t))
            )
            for bit in NAMES:
                assert np.array_equal(pitched.mask(bit)[:, 16], other.mask(bit)[:, 16]), NAMES[bit]
            differ += int((pitched.mask(KF) != level.mask(KF))[:, 16].sum())
    assert differ > 10


def test_the_hip_of_a_tilted_trunk_that_turns_moves_as_the_trunk_carries_it(robots):
    robot, twist = robots[0], (0.3, -0.1, 0.02, 0.1, -0.2, 0.4)
    for leg in range(4):
        hip = place(robot.hips[leg], 0.2, -0.3, 0.0)
        expected = np.array(twist[:3]) + np.cross(twist[3:], hip)
        assert hip_velocity(robot, leg, twist, roll=0.2, pitch=-0.3) == pytest.approx(expected, abs=1e-12)
        level = np.array(twist[:3]) + np.cross(twist[3:], robot.hips[leg])
        assert hip_velocity(robot, leg, twist) == pytest.approx(level, abs=1e-12)
        assert np.abs(expected - level).max() > 0.01
