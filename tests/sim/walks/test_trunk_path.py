"""ViTAL's worlds against their heights as plain formulas, cell by cell."""

import numpy as np
import pytest

from legtool.sim.walks.trunk_path import vital_map, vital_world

X, Y = np.arange(-2.0, 4.5, 0.02) + 0.01, np.arange(-1.0, 1.0, 0.02) + 0.01


def steps(rise, go, count):
    up = np.clip(np.floor((X - 0.3) / go) + 1, 0, count)
    top = 0.3 + (count - 1) * go + 0.8
    return rise * (up - np.clip(np.floor((X - top) / go) + 1, 0, count))


def cobbles(seed):
    rng = np.random.default_rng(14 + seed)
    edges_x, edges_y = (np.cumsum(rng.integers(8, 13, count)) for count in (60, 40))
    tops = rng.uniform(0, 0.12, (61, 41))
    h = tops[np.ix_(np.searchsorted(edges_x, np.arange(len(X))), np.searchsorted(edges_y, np.arange(len(Y))))]
    return np.where(((X > 0.3) & (X < 2.3))[:, None], h, 0.0)


def gapped():
    gaps = ((X > 0.50) & (X < 0.56)) | ((X > 1.3) & (X < 1.36))
    return steps(0.10, 0.30, 3) - 0.4 * gaps


FORMULAS = {
    "vital_stairs": lambda seed: steps(0.10, 0.25, 3),
    "vital_stairs_go28": lambda seed: steps(0.10, 0.28, 3),
    "vital_low_stairs": lambda seed: steps(0.06, 0.40, 2),
    "vital_gapped_stairs": lambda seed: gapped(),
    "vital_rough": cobbles,
}


@pytest.mark.parametrize("name", FORMULAS)
@pytest.mark.parametrize(("seed", "scale"), [(0, 1.0), (3, 1.0), (1, 0.6)])
def test_heights_are_those_of_the_formulas(name, seed, scale):
    heights = FORMULAS[name](seed)
    if heights.ndim == 1:
        heights = np.repeat(heights[:, None], len(Y), axis=1)
    found = vital_map(vital_world(name, seed=seed, scale=scale))
    np.testing.assert_array_equal(found.heights, (scale * heights).astype(np.float32))
    assert found.lower_corner == pytest.approx([-2.0, -1.0])


def test_a_gaps_floor_is_no_ground():
    world = vital_world("vital_gapped_stairs")
    assert world.on_ground([[0.53, 0, -0.3], [0.45, 0, 0.1]]).tolist() == [False, True]
