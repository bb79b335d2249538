"""True regions against the world's own judge of ground."""

import numpy as np
import pytest

from legtool.configs.families import FAMILIES
from legtool.configs.worlds import load_world
from legtool.sim.worlds import raycast as rc
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.builder import Builder
from legtool.sim.worlds.carriers import TOP
from legtool.sim.worlds.steppable_regions import near, steppable_regions
from legtool.sim.worlds.world import CUBOID, CYLINDRIC, RAMP, World
from legtool_runtime.perception.regions import Regions
from legtool_runtime.rotations import from_angles


def around(world: World) -> tuple[tuple[float, float], tuple[float, float]]:
    ends = np.array([world.start[:2], world.goal])
    low, high = ends.min(axis=0) - 0.6, ends.max(axis=0) + 0.6
    return (low[0], low[1]), (high[0], high[1])


def inside(regions: Regions, index: int, points: np.ndarray, slack: float = 0.0) -> np.ndarray:
    """Whether points (m, 2) lie in a region, seen from above."""
    pose = regions.poses[index]
    corners = regions.corners_world(index)[:, :2]
    out = np.ones(len(points), dtype=bool)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        outward = np.array([b[1] - a[1], a[0] - b[0]]) / np.hypot(*(b - a))
        out &= (points - a) @ outward <= slack
    assert pose[2, 2] > 0
    return out


@pytest.mark.parametrize(
    ("name", "seed"), [(name, seed) for name in FAMILIES for seed in (None, 1) if seed is None or FAMILIES[name].drawn]
)
def test_regions_lie_on_ground_and_hold_all_of_it(name: str, seed: int | None) -> None:
    world = build_world(FAMILIES[name].settings(seed))
    low, high = around(world)
    regions = steppable_regions(world, low, high, least_area=0.0)
    rng = np.random.default_rng(0)
    # Every place in a region is ground, and the highest thing there is, and in its plane.
    share = rng.dirichlet(np.ones(3), len(regions))
    for k in range(len(regions)):
        corners = regions.corners_world(k)
        middle = corners.mean(axis=0)
        place = middle + 0.999 * (share[k] @ corners[rng.permutation(len(corners))[:3]] - middle)
        assert world.height(*place[:2]) == pytest.approx(place[2], abs=2e-6)
        assert world.on_ground(place[None])[0]
    # Every place that is ground is in just one region, but for what is cut off round stones to make them polygons.
    points = np.column_stack([rng.uniform(low[k], high[k], 3000) for k in range(2)])
    heights = world.height(points[:, 0], points[:, 1])
    # A foot stands over a crack, in which there is no region.
    ground = np.isfinite(heights) & world._stands(np.column_stack([points, heights]))
    count = sum(inside(regions, k, points).astype(int) for k in range(len(regions)))
    assert (count[~ground] == 0).all()
    assert count.max() == 1
    missed = (count[ground] == 0).mean()
    assert missed < (0.01 if name == "ramped_stepping_stones" else 1e-3)


def test_what_stands_on_a_face_and_what_is_above_it_is_left_out() -> None:
    builder = Builder()
    builder.add(CUBOID, rc.box([0.0, 0.0, 0.05], np.eye(3), (0.1, 0.1, 0.05)), 0.1)
    builder.add(CYLINDRIC, rc.cylinder([0.5, 0.5, 0.6], np.eye(3), 0.1, 0.05), 0.65)
    builder.add(RAMP, rc.wedge([-0.5, 0.5, 0.1], np.eye(3), (0.2, 0.2, 0.1)), 0.2)
    builder.add(CUBOID, rc.box([-0.5, -0.5, 0.2], np.eye(3), (0.1, 0.1, 0.2)), 0.4, ground=False)
    regions = steppable_regions(builder.world, (-1.0, -1.0), (1.0, 1.0), least_area=0.0)
    floor = np.isclose(regions.poses[:, 2, 3], 0.0)
    covered = 0.2 * 0.2 + np.pi * 0.1**2 + 0.4 * 0.4 + 0.2 * 0.2
    assert regions.areas[floor].sum() == pytest.approx(4.0 - covered, rel=2e-3)
    # Tops, and the slope's area along itself; what is no ground has none.
    others = regions.areas[~floor].sum()
    assert others == pytest.approx(0.04 + np.pi * 0.1**2 + 0.4 * np.hypot(0.4, 0.2), rel=1e-2)


def test_frames_are_those_of_perception() -> None:
    world = build_world(load_world("rubble"))
    regions = steppable_regions(world, (-0.2, 0.8), (1.0, 2.0))
    rotations = regions.poses[:, :3, :3]
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (len(regions), 1, 1)),
                               atol=1e-12)  # fmt: skip
    assert (rotations[:, 2, 2] > TOP).all() and np.allclose(rotations[:, 0, 1], 0.0)
    assert (rotations[:, 0, 0] > 0.0).all()
    assert not regions.overhang.any() and not regions.assumed.any()
    for boundary, size in zip(regions.boundaries, regions.areas, strict=True):
        x, y = boundary.T
        assert 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)) == pytest.approx(size)


def test_a_plate_on_edge_offers_its_edge_and_a_tilted_box_two_faces() -> None:
    builder = Builder(floor=False)
    builder.add(CUBOID, rc.box([0.0, 0.0, 0.0], from_angles(0.0, 0.5 * np.pi, 0.0), (0.3, 0.4, 0.02)), 0.3)
    builder.add(CUBOID, rc.box([2.0, 0.0, 0.0], from_angles(0.0, 0.25 * np.pi, 0.0), (0.1, 0.4, 0.1)), 0.2)
    regions = steppable_regions(builder.world, (-1.0, -1.0), (3.0, 1.0))
    plate = regions.poses[:, 0, 3] < 1.0
    assert regions.areas[plate].sum() == pytest.approx(0.04 * 0.8)
    assert regions.areas[~plate].sum() == pytest.approx(2 * 0.2 * 0.8)


def test_of_two_faces_in_one_plane_only_one_is_a_region() -> None:
    builder = Builder(floor=False)
    for x in (0.0, 0.2):
        builder.add(CUBOID, rc.box([x, 0.0, -0.1], np.eye(3), (0.2, 0.2, 0.1)), 0.0)
    regions = steppable_regions(builder.world, (-1.0, -1.0), (1.0, 1.0))
    assert regions.areas.sum() == pytest.approx(0.6 * 0.4)


def test_regions_near_a_place_keep_their_ids() -> None:
    world = build_world(load_world("sparse_stepping_stones"))
    regions = steppable_regions(world, *around(world))
    here = near(regions, [0.0, 1.4, 0.5], 0.7)
    assert 0 < len(here) < len(regions)
    for k, number in enumerate(here.ids):
        np.testing.assert_array_equal(here.boundaries[k], regions.boundaries[number])
        assert np.hypot(*(here.poses[k, :2, 3] - [0.0, 1.4])) <= 0.7
    assert len(near(regions, [50.0, 0.0], 1.0)) == 0
