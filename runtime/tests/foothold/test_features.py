import numpy as np
import pytest

from legtool_runtime.foothold import Criteria, Gait
from legtool_runtime.foothold.features import FEATURES, NEARNESS, encode
from legtool_runtime.foothold.heightmap import nearest_safe

NAMES = [name for name, _ in FEATURES]


@pytest.fixture(scope="module")
def criteria(robots):
    return Criteria(robots[0])


def encoded(criteria, leg, heights, twist, *, dense, vpa=0, nominal=(0.06, 0.0)):
    return encode(
        criteria,
        dense=dense,
        heights=heights[None],
        leg=[leg],
        hip_height=[0.6],
        base_twist=[twist],
        gait=[[0.24, 1.4, 0.55, 10.0]],
        nominal=[nominal],
        vpa=[vpa],
    )


def step(ahead):
    heights = np.zeros((33, 33), np.float32)
    heights[ahead:] = 0.1
    return heights


def test_the_papers_networks_see_how_near_allowed_cells_are_and_which_is_nearest(criteria):
    heights, twist = step(17), (0.3, 0.0, 0.0, 0.0, 0.0, 0.0)
    (image,), _, _ = encoded(criteria, 0, heights, twist, dense=False)
    allowed = criteria.allowed(
        heights, leg=0, hip_height=0.6, base_twist=twist, gait=Gait(0.24, 1.4, 0.55), nominal=(0.06, 0.0)
    )
    nearest = nearest_safe(allowed, twist)
    assert not allowed[16, 16] and nearest is not None
    expected = np.where(allowed, NEARNESS, 0)
    expected[nearest] += 1
    assert np.array_equal(image[1], expected)
    assert NEARNESS[16, 16] == 1 and NEARNESS[0, 0] == pytest.approx(0, abs=1e-6)


def test_below_hips_they_see_what_is_smooth(criteria):
    (image,), _, _ = encoded(criteria, 0, step(17), (0.3, 0, 0, 0, 0, 0), dense=False, vpa=1, nominal=(0, 0))
    assert set(np.unique(image[1])) == {0.0, 1.0}
    assert not image[1][15:19].any() and image[1][5:12, 5:28].all()


def test_right_legs_are_told_the_mirror_image(criteria):
    rng = np.random.default_rng(0)
    heights = np.where(rng.random((33, 33)) < 0.02, 0.1, 0).astype(np.float32)
    for dense in (False, True):
        left = encoded(criteria, 0, heights, (0.3, 0.1, 0, 0, 0, 0.2), dense=dense, nominal=(0.06, 0.02))
        right = encoded(criteria, 1, heights[:, ::-1], (0.3, -0.1, 0, 0, 0, -0.2), dense=dense, nominal=(0.06, -0.02))
        for one, other in zip(left, right, strict=True):
            assert one == pytest.approx(other, abs=1e-6)


def test_the_dense_network_is_told_where_the_foot_lifts_off(criteria):
    (image,), (vector,), _ = encoded(criteria, 0, step(17), (0.3, 0.0, 0.0, 0.0, 0.0, 0.0), dense=True)
    assert image.shape == (1, 33, 33)
    place = criteria.lift_off(
        step(17), leg=0, hip_height=0.6, base_twist=(0.3, 0, 0, 0, 0, 0), gait=Gait(0.24, 1.4, 0.55), nominal=(0.06, 0)
    )
    assert vector[NAMES.index("lift_off_x_m") :][:3] == pytest.approx(place, abs=1e-6)
