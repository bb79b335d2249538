import math
from dataclasses import replace

import numpy as np
import pytest

from legtool_runtime.errors import MapError, StateError
from legtool_runtime.foothold import Criteria, Gait, Tuple
from legtool_runtime.foothold.gait import hip_velocity
from legtool_runtime.foothold.heightmap import extract_heightmap, nearest_safe
from legtool_runtime.foothold.selection import FootholdSelector
from legtool_runtime.foothold.swing import Swing
from legtool_runtime.rotations import place
from legtool_runtime.terrain.elevation import HeightMap


class Fixed:
    """A network that always proposes the same."""

    def __init__(self, robot, cell):
        self.robot, self.cell = robot, cell

    def propose(self, t):
        return self.cell


@pytest.fixture(scope="module")
def criteria(robots):
    return Criteria(robots[0])


def level_map(size=121, resolution=0.02):
    return HeightMap(np.zeros((size, size), np.float32), resolution, np.zeros(2))


def by_sorting(safe, direction):
    """The definition, by sorting all safe cells."""

    def key(cell):
        d = np.array(cell) - 16
        angle = math.atan2(d[1], d[0]) - math.atan2(direction[1], direction[0])
        angle = (angle + math.pi) % (2 * math.pi) - math.pi
        return (int(d @ d), round(abs(angle), 6), -angle)

    cells = [tuple(int(i) for i in cell) for cell in np.argwhere(safe)]
    return min(cells, key=key, default=None)


def test_the_nearest_safe_cell_is_chosen_and_ties_by_angle_from_the_direction_of_travel():
    rng = np.random.default_rng(0)
    for _ in range(300):
        safe = rng.random((33, 33)) < rng.choice([0.01, 0.1, 0.5])
        angle = rng.uniform(-np.pi, np.pi)
        direction = (np.cos(angle), np.sin(angle))
        assert nearest_safe(safe, direction) == by_sorting(safe, direction)
    ring = np.zeros((33, 33), bool)
    ring[[15, 17, 16, 16], [16, 16, 15, 17]] = True
    assert nearest_safe(ring, (0.0, 0.0)) == (17, 16)
    assert nearest_safe(np.zeros((33, 33), bool), (1.0, 0.0)) is None


def test_verified_never_returns_an_unsafe_cell_and_none_only_where_none_is_safe(criteria, slow):
    rng = np.random.default_rng(1)
    seen = {"cnn": 0, "exact": 0, None: 0}
    for _ in range(150):
        case = slow.case(rng, criteria.robot)
        case["heights"] = np.minimum(case["heights"], 0.3)
        case["nominal"] = case["nominal"] or (0.05, 0.0)
        cell = tuple(int(i) for i in rng.integers(10, 23, 2)) if rng.random() < 0.9 else None
        t = Tuple(**case)
        safe = criteria.evaluate(t).safe
        got = FootholdSelector(criteria, method="verified", network=Fixed(criteria.robot, cell)).select(t)
        exact = FootholdSelector(criteria).select(t)
        assert got.verified
        if safe.any():
            assert safe[got.cell]
            assert got.by == ("cnn" if cell is not None and safe[cell] else "exact")
            assert safe[exact.cell]
        else:
            assert got.cell is None and exact.cell is None
            assert str(got) == "no safe foothold"
        seen[got.by if got.cell else None] += 1
    assert min(seen.values()) > 0


class Adversary:
    """A network that knows the exact answer and proposes what is wrong: an unsafe cell where there is one."""

    def __init__(self, rng):
        self.rng, self.robot, self.safe = rng, None, None

    def propose(self, t):
        kind = self.rng.integers(4)
        if kind == 0:
            return None
        if kind == 1:
            return tuple(int(i) for i in self.rng.integers(-3, 36, 2))
        cells = np.argwhere(~self.safe if kind == 2 and not self.safe.all() else np.ones((33, 33), bool))
        return tuple(int(i) for i in self.rng.choice(cells))


@pytest.mark.slow
def test_verified_is_never_unsafe_in_a_hundred_thousand_cases(robots, slow):
    rng = np.random.default_rng(2)
    judges = [Criteria(robot) for robot in robots]
    network = Adversary(rng)
    answered = unsafe = missed = none = refused = by_network = 0
    while answered < 100_000:
        judge = judges[answered % 2]
        case = slow.case(rng, judge.robot)
        case["heights"], case["nominal"] = np.minimum(case["heights"], 0.3), case["nominal"] or (0.05, 0.0)
        for _ in range(4):
            case["leg"], case["hip_height"] = int(rng.integers(4)), rng.uniform(0.42, 0.75)
            t = Tuple(**case)
            network.robot, network.safe = judge.robot, judge.evaluate(t).safe
            got = FootholdSelector(judge, method="verified", network=network).select(t)
            answered += 1
            by_network += got.by == "cnn"
            if got.cell is None:
                none += 1
                missed += bool(network.safe.any())
                refused += str(got) == "no safe foothold"
            else:
                unsafe += not network.safe[got.cell]
    print(f"verified: {unsafe} unsafe and {missed} missed of {answered}; {by_network} proposals held; {none} had none")
    assert unsafe == missed == 0 and refused == none > 1000 and by_network > 1000


def test_cnn_takes_the_proposal_as_it_is(criteria):
    heights = np.zeros((33, 33))
    heights[20] = 1.0
    t = Tuple(heights, leg=0, hip_height=0.56, base_twist=(0.0,) * 6, gait=Gait(), nominal=(0.0, 0.0))
    got = FootholdSelector(criteria, method="cnn", network=Fixed(criteria.robot, (20, 16))).select(t)
    assert got.cell == (20, 16) and not got.verified and "not verified" in str(got)


def test_methods_that_need_a_network_say_so(criteria):
    with pytest.raises(StateError, match="needs a network"):
        FootholdSelector(criteria, method="verified")
    with pytest.raises(StateError, match="expected one of exact, cnn, verified"):
        FootholdSelector(criteria, method="best")


def test_the_world_foothold_lies_ahead_of_the_hip_and_moves_with_the_frame(criteria):
    selector = FootholdSelector(criteria)
    gait = Gait(0.2, 1.4, 0.55, 0.2)
    twist = (0.3, 0.0, 0.0, 0.0, 0.0, 0.0)
    found = selector.select_in(
        level_map(), leg=0, base_position=(0, 0, 0.64), attitude=(0, 0, 0), base_twist=twist, gait=gait
    )
    ahead = 0.3735 + 0.3 * (0.2 + gait.stance_s / 2)
    assert found.nominal == pytest.approx([ahead, 0.207])
    assert found.position == pytest.approx([ahead, 0.207, 0.02])
    assert found.hip_height == pytest.approx(0.56)
    turned = selector.select_in(
        level_map(), leg=0, base_position=(0, 0, 0.64), attitude=(0, 0, np.pi / 2), base_twist=twist, gait=gait
    )
    assert turned.nominal == pytest.approx([-0.207, ahead])


def test_legs_are_judged_below_the_trunk_as_it_is_planned_for_touchdown(criteria):
    # Nose up, the front thighs have no range left for a foot right below the hip.
    asked = []

    class Watch(Fixed):
        def propose(self, t):
            asked.append(t)
            return super().propose(t)

    selector = FootholdSelector(criteria, method="verified", network=Watch(criteria.robot, None))
    twist, gait = (0.1, 0.0, 0.0, 0.0, 0.2, 0.1), Gait(0.1, 1.4, 0.55, 0.2)
    roll, pitch = 0.05, -0.3
    found = selector.select_in(
        level_map(), leg=0, base_position=(0, 0, 0.47), attitude=(roll, pitch, 0.3), base_twist=twist, gait=gait
    )
    (t,) = asked
    assert (t.roll, t.pitch) == (roll, pitch)
    hip = place(criteria.robot.hips[0], roll, pitch, 0.3)
    velocity = hip_velocity(criteria.robot, 0, twist, roll=roll, pitch=pitch)
    assert t.hip_height == found.hip_height == pytest.approx(0.47 + hip[2] + velocity[2] * 0.2)
    tilted, level = criteria.evaluate(t), criteria.evaluate(replace(t, roll=0.0, pitch=0.0))
    assert level.safe[16, 16] and not tilted.safe[16, 16]
    assert tilted.safe[found.selection.cell] and found.selection.cell == nearest_safe(tilted.safe, velocity)


def test_a_nominal_foothold_outside_of_the_map_is_refused(criteria):
    with pytest.raises(MapError, match="outside of the map"):
        FootholdSelector(criteria).select_in(
            level_map(33), leg=0, base_position=(0.9, 0, 0.64), attitude=(0, 0, 0), base_twist=(0.0,) * 6, gait=Gait()
        )


def test_heightmaps_are_cut_by_the_nearest_cell():
    rng = np.random.default_rng(2)
    heights = rng.normal(size=(101, 91)).astype(np.float32)
    elevation = HeightMap(heights, 0.02, np.array([0.4, -0.2]))
    straight = extract_heightmap(elevation, elevation.center + np.array([0.04, -0.06]), yaw=0.0)
    assert np.array_equal(straight, heights[50 + 2 - 16 : 50 + 2 + 17, 45 - 3 - 16 : 45 - 3 + 17])
    quarter = extract_heightmap(elevation, elevation.center, yaw=np.pi / 2)
    # x of the cut points along y of the world, y of the cut against x of the world.
    assert np.array_equal(quarter, heights[34:67, 29:62][::-1].T)
    edge = extract_heightmap(elevation, elevation.center + np.array([0.99, 0.0]), yaw=0.0)
    assert np.isnan(edge[-10:]).all() and not np.isnan(edge[0]).any()


def test_another_resolution_is_resampled_only_where_asked_for():
    coarse = HeightMap(np.arange(30 * 30, dtype=np.float32).reshape(30, 30), 0.04, np.zeros(2))
    with pytest.raises(MapError, match="resample=True"):
        extract_heightmap(coarse, (0, 0), yaw=0.0)
    cut = extract_heightmap(coarse, (0.01, 0.01), yaw=0.0, resample=True)
    assert set(np.unique(cut)) <= set(np.unique(coarse.heights))
    assert cut[16, 16] == coarse.heights[15, 15]


def test_a_swing_bends_to_a_new_foothold_without_a_jump():
    swing = Swing(np.array([0, 0, 0.02]), np.array([0.3, 0, 0.02]), 0.12)
    assert swing.position(0.0) == pytest.approx([0, 0, 0.02])
    assert swing.position(0.5) == pytest.approx([0.15, 0, 0.14])
    bent = swing.adjust((0.34, 0.04, 0.12), phase=0.4)
    again = bent.adjust((0.30, 0.02, 0.12), phase=0.7)
    for s in (bent, again):
        assert s.position(1.0) == pytest.approx(s.foothold, abs=1e-6)
        assert s.position(0.4) == pytest.approx(swing.position(0.4))
    path = np.array([again.position(s) for s in np.linspace(0, 1, 2001)])
    assert np.abs(np.diff(path, 2, axis=0)).max() < 2e-5
    fresh = swing.adjust((0.34, 0.04, 0.12), phase=0.0)
    assert not fresh.bends
    with pytest.raises(StateError, match="on the ground"):
        swing.adjust((0.3, 0, 0), phase=1.0)
