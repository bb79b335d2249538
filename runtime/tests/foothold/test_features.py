import numpy as np
import pytest

from legtool_runtime.foothold import Criteria, Gait, hip_heights
from legtool_runtime.foothold.features import FEATURES, NEARNESS, encode
from legtool_runtime.foothold.heightmap import nearest_safe

NAMES = [name for name, _ in FEATURES]


@pytest.fixture(scope="module")
def criteria(robots):
    return Criteria(robots[0])


def encoded(criteria, leg, heights, twist, kind, *, nominal=(0.06, 0.0)):
    return encode(
        criteria,
        kind,
        heights=heights[None],
        leg=[leg],
        hip_height=[0.6],
        base_twist=[twist],
        gait=[[0.24, 1.4, 0.55, 10.0]],
        nominal=[nominal],
        vpa=[int(kind == "vpa")],
    )


def step(ahead):
    heights = np.zeros((33, 33), np.float32)
    heights[ahead:] = 0.1
    return heights


def test_the_vfa_network_is_told_how_near_cells_are_that_seem_safe_and_which_is_nearest(criteria):
    heights, twist = step(17), (0.3, 0.0, 0.0, 0.0, 0.0, 0.0)
    (glance,) = encoded(criteria, 0, heights, twist, "vfa").glance
    seems = criteria.glance(
        heights, leg=0, hip_height=0.6, base_twist=twist, gait=Gait(0.24, 1.4, 0.55), nominal=(0.06, 0.0)
    )
    nearest = nearest_safe(seems, twist)
    assert not seems[16, 16] and nearest is not None
    expected = np.where(seems, NEARNESS, 0)
    expected[nearest] += 1
    assert np.array_equal(glance, expected)
    assert NEARNESS[16, 16] == 1 and NEARNESS[0, 0] == pytest.approx(0, abs=1e-6)


def test_the_vpa_network_is_told_about_how_many_footholds_are_safe_above_the_median(criteria):
    heights, twist = step(17), (0.3, 0, 0, 0, 0, 0)
    (glance,) = encoded(criteria, 0, heights, twist, "vpa", nominal=(0, 0)).glance
    (raised,) = encoded(criteria, 0, heights + 0.5, twist, "vpa", nominal=(0, 0)).glance
    exact = criteria.counts(
        heights, leg=0, hip_heights=hip_heights(criteria.robot), base_twist=twist, gait=Gait(0.24, 1.4, 0.55)
    )
    assert np.abs(glance[0] - exact).mean() < 0.15 * exact.mean()
    assert np.abs(raised - glance).max() <= 3  # rounding moves cells over a bound


@pytest.mark.parametrize("kind", ["vfa", "vpa", "dense"])
def test_right_legs_are_told_the_mirror_image(criteria, kind):
    rng = np.random.default_rng(0)
    heights = np.where(rng.random((33, 33)) < 0.02, 0.1, 0).astype(np.float32)
    left = encoded(criteria, 0, heights, (0.3, 0.1, 0, 0, 0, 0.2), kind, nominal=(0.06, 0.02))
    right = encoded(criteria, 1, heights[:, ::-1], (0.3, -0.1, 0, 0, 0, -0.2), kind, nominal=(0.06, -0.02))
    for name, values in left.fed().items():
        # Where the leg passes over the very border of two cells, rounding tells which.
        few = 0 if name != "glance" else 62 if kind == "vpa" else 3
        other = np.abs(values - right.fed()[name])
        assert (~(other < 1e-5) & ~np.isnan(values)).sum() <= few and not (kind == "vpa" and (other > 5).any())


def test_the_dense_network_is_told_where_the_foot_lifts_off(criteria):
    inputs = encoded(criteria, 0, step(17), (0.3, 0.0, 0.0, 0.0, 0.0, 0.0), "dense")
    (vector,) = inputs.vector
    assert inputs.glance is None
    place = criteria.lift_off(
        step(17), leg=0, hip_height=0.6, base_twist=(0.3, 0, 0, 0, 0, 0), gait=Gait(0.24, 1.4, 0.55), nominal=(0.06, 0)
    )
    assert vector[NAMES.index("lift_off_x_m") :][:3] == pytest.approx(place, abs=1e-6)
