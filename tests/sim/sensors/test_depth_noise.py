import numpy as np
import pytest
from scipy import ndimage

from legtool.configs.camera import DepthNoise
from legtool.sim.sensors import depth_noise as noise


@pytest.fixture
def step():
    """A step in depth, from 1.5 m to 2.5 m, below a sky."""
    depth = np.full((120, 160), 1.5, dtype=np.float32)
    depth[:, 80:] = 2.5
    depth[:20] = np.nan
    geom = (depth > 2).astype(np.int32)
    geom[:20] = -1
    return depth, geom


@pytest.mark.parametrize("name", noise.STEPS)
def test_a_step_repeats_with_its_seed_and_leaves_the_sky_and_its_input_alone(step, name):
    depth, geom = step
    given = depth.copy()
    one, two = (noise.STEPS[name](depth, geom, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(depth, given)
    assert one.dtype == np.float32 and one.shape == depth.shape
    assert np.isnan(one[:20]).all()
    assert not np.array_equal(one, depth, equal_nan=True)


def test_oil_painting_and_strong_noise_stay_inside_the_dilated_boundaries(step):
    depth, geom = step
    inside = noise.boundaries(depth, geom)
    oily = noise.oil_painting(depth, geom, np.random.default_rng(0))
    changed = (oily != depth) & ~np.isnan(depth)
    assert changed.any() and not (changed & ~inside).any()
    noisy = noise.gaussian_noise(depth, geom, np.random.default_rng(0))
    error = np.abs(noisy - depth)
    assert np.nanstd(error[inside]) > 2 * np.nanstd(error[~inside])


def test_oil_painting_makes_a_straight_boundary_ragged_and_invents_no_depth_between(step):
    depth, geom = step
    oily = noise.oil_painting(depth, geom, np.random.default_rng(1))
    where = np.argmax(oily[30:110] > 2, axis=1)
    assert len(np.unique(where)) > 2
    assert set(np.unique(oily[30:110])) == {1.5, 2.5}


def test_noise_grows_with_the_square_of_depth_over_surfaces():
    geom = np.zeros((200, 200), dtype=np.int32)
    near, far = (
        np.std(noise.gaussian_noise(np.full(geom.shape, z, np.float32), geom, np.random.default_rng(2)) - z)
        for z in (1.0, 3.0)
    )
    assert near == pytest.approx(noise.USUAL.surface_sigma, rel=0.05)
    assert far / near == pytest.approx(9, rel=0.05)


def test_voids_are_connected_groups_no_larger_than_they_may_be(step):
    depth, geom = step
    largest = 0
    for seed in range(20):
        holes = np.isnan(noise.void_blobs(depth, geom, np.random.default_rng(seed))) & ~np.isnan(depth)
        _, count = ndimage.label(holes)
        assert count <= noise.BOUNDARY_VOIDS + noise.SURFACE_VOIDS
        assert holes.sum() <= (noise.BOUNDARY_VOIDS + noise.SURFACE_VOIDS) * noise.VOID_SIZE[1]
        largest = max(largest, int(holes.sum()))
    assert largest > 100


def test_blur_is_a_weighted_mean_of_the_returns_only(step):
    depth, geom = step
    soft = noise.blur(depth, geom, np.random.default_rng(0))
    assert soft[60, 40] == pytest.approx(1.5) and soft[20, 40] == pytest.approx(1.5)
    assert 1.5 < soft[60, 79] < 2.0 < soft[60, 80] < 2.5


def test_corrupting_runs_the_named_steps_in_order_each_with_its_own_stream(step):
    depth, geom = step
    whole = noise.corrupt(depth, geom, DepthNoise(steps=("oil_painting", "gaussian_noise")), np.random.default_rng(3))
    assert not np.array_equal(
        whole,
        noise.corrupt(depth, geom, DepthNoise(steps=("gaussian_noise", "oil_painting")), np.random.default_rng(3)),
        equal_nan=True,
    )
    np.testing.assert_array_equal(noise.corrupt(depth, geom, DepthNoise(steps=()), np.random.default_rng(3)), depth)
    # Leaving a step out does not change what the others draw.
    alone = noise.corrupt(depth, geom, DepthNoise(steps=("gaussian_noise",)), np.random.default_rng(3))
    far = ~noise.boundaries(depth, geom, width=16)
    np.testing.assert_array_equal(alone[far], whole[far])


def test_errors_keep_their_angle_in_smaller_images_of_the_same_camera():
    """Half of the pixels across: boundaries are half as many pixels wide, blobs a quarter as large."""
    shares = {}
    for width in (640, 320):
        depth = np.full((width * 3 // 4, width), 2.0, np.float32)
        geom = np.zeros(depth.shape, np.int32)
        geom[:, width // 2 :], depth[:, width // 2 :] = 1, 1.0
        voids = [np.isnan(noise.void_blobs(depth, geom, np.random.default_rng(seed))).mean() for seed in range(20)]
        shares[width] = noise.boundaries(depth, geom).mean(), np.mean(voids)
    assert shares[320][0] == pytest.approx(shares[640][0], rel=0.3)
    assert shares[320][1] == pytest.approx(shares[640][1], rel=0.4)
