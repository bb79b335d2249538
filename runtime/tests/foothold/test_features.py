import numpy as np
import pytest

from legtool_runtime.foothold import Criteria, Gait, Tuple, hip_heights
from legtool_runtime.foothold.features import COARSE_INPUT, FEATURES, NEARNESS, encode
from legtool_runtime.foothold.gait import hip_velocity
from legtool_runtime.foothold.heightmap import nearest_safe

NAMES = [name for name, _ in FEATURES]


@pytest.fixture(scope="module")
def criteria(robots):
    return Criteria(robots[0])


GAIT = Gait(0.24, 1.4, 0.55)


def encoded(criteria, leg, heights, twist, kind, *, nominal=(0.06, 0.0), roll=0.0, pitch=0.0):
    how = dict(hip_height=0.6, base_twist=twist, gait=GAIT, nominal=None if kind == "vpa" else nominal)
    return encode(criteria, kind, [Tuple(heights, leg=leg, roll=roll, pitch=pitch, **how)])


def step(ahead):
    heights = np.zeros((33, 33), np.float32)
    heights[ahead:] = 0.1
    return heights


def test_the_vfa_network_is_told_how_near_cells_are_that_seem_safe_and_which_is_nearest(criteria):
    heights, twist = step(17), (0.3, 0.0, 0.0, 0.0, 0.0, 0.0)
    (coarse,) = encoded(criteria, 0, heights, twist, "vfa").coarse
    seems = criteria.coarse(Tuple(heights, leg=0, hip_height=0.6, base_twist=twist, gait=GAIT, nominal=(0.06, 0.0)))
    nearest = nearest_safe(seems, twist)
    assert not seems[16, 16] and nearest is not None
    expected = np.where(seems, NEARNESS, 0)
    expected[nearest] += 1
    assert np.array_equal(coarse, expected)
    assert NEARNESS[16, 16] == 1 and NEARNESS[0, 0] == pytest.approx(0, abs=1e-6)


def test_the_vpa_network_is_told_about_how_many_footholds_are_safe_above_the_median(criteria):
    heights, twist = step(17), (0.3, 0, 0, 0, 0, 0)
    (coarse,) = encoded(criteria, 0, heights, twist, "vpa").coarse
    (raised,) = encoded(criteria, 0, heights + 0.5, twist, "vpa").coarse
    exact = criteria.counts(Tuple(heights, leg=0, base_twist=twist, gait=GAIT), hip_heights(criteria.robot))
    assert np.abs(coarse[0] - exact).mean() < 0.15 * exact.mean()
    assert np.abs(raised - coarse).max() <= 3  # rounding moves cells over a bound


@pytest.mark.parametrize("kind", ["vfa", "vpa", "dense"])
def test_right_legs_are_told_the_mirror_image(criteria, kind):
    rng = np.random.default_rng(0)
    heights = np.where(rng.random((33, 33)) < 0.02, 0.1, 0).astype(np.float32)
    left = encoded(criteria, 0, heights, (0.3, 0.1, 0, 0, 0, 0.2), kind, nominal=(0.06, 0.02), roll=0.1, pitch=-0.2)
    mirrored = dict(nominal=(0.06, -0.02), roll=-0.1, pitch=-0.2)
    right = encoded(criteria, 1, heights[:, ::-1], (0.3, -0.1, 0, 0, 0, -0.2), kind, **mirrored)
    told = dict(zip(NAMES, left.vector[0], strict=True))
    assert told["roll"] == pytest.approx(0.1) and told["pitch"] == pytest.approx(-0.2)
    for name, values in left.fed().items():
        # Where the leg passes over the very border of two cells, rounding tells which.
        few = 0 if name != COARSE_INPUT else 62 if kind == "vpa" else 3
        other = np.abs(values - right.fed()[name])
        assert (~(other < 1e-5) & ~np.isnan(values)).sum() <= few and not (kind == "vpa" and (other > 5).any())


def test_the_dense_network_is_told_where_the_foot_lifts_off(criteria):
    twist = (0.3, 0.0, 0.0, 0.0, 0.0, 0.0)
    inputs = encoded(criteria, 0, step(17), twist, "dense")
    (vector,) = inputs.vector
    assert inputs.coarse is None
    place = criteria.lift_off(Tuple(step(17), leg=0, hip_height=0.6, base_twist=twist, gait=GAIT, nominal=(0.06, 0.0)))
    assert vector[NAMES.index("lift_off_x_m") :][:3] == pytest.approx(place, abs=1e-6)


def test_networks_are_told_how_the_hip_of_a_tilted_trunk_moves(criteria):
    twist, tilt = (0.3, 0.1, 0.0, 0.1, -0.1, 0.4), dict(roll=0.1, pitch=-0.3)
    for leg in range(4):
        (vector,) = encoded(criteria, leg, step(17), twist, "vfa", **tilt).vector
        moved = hip_velocity(criteria.robot, leg, twist, **tilt) * np.array([1, -1 if leg % 2 else 1, 1])
        first = NAMES.index("hip_velocity_x")
        assert vector[first : first + 3] == pytest.approx(moved, abs=1e-6)
