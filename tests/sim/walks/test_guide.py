import numpy as np
import pytest

from legtool.configs.worlds import WorldSettings, load_world
from legtool.sim.walks.guide import Guide, progress
from legtool.sim.worlds.build import build_world


def corner(**changes: object):
    """A way that turns a corner at (2, 0)."""
    return build_world(
        WorldSettings(name="corner", start=(0, 0, 0), via=((2, 0),), goal=(2, 3), goal_radius=0.25).replace(**changes)
    )


def test_the_goal_counts_only_once_all_places_before_it_are_passed() -> None:
    guide = Guide(corner())
    np.testing.assert_array_equal(guide.target([0.0, 0.0, 0.5]), [2.0, 0.0])
    assert guide.remaining([0.0, 0.0]) == pytest.approx(5.0)
    assert guide.remaining([2.0, 3.0]) == pytest.approx(6.0)  # there, but the corner is still ahead
    assert guide.remaining([1.9, 0.1]) == pytest.approx(np.hypot(0.1, 2.9) - 0.25)
    np.testing.assert_array_equal(guide.target([1.0, 0.0]), [2.0, 3.0])
    assert guide.remaining([2.0, 2.9]) <= 0.0


def test_without_places_on_the_way_it_is_the_worlds_own_distance() -> None:
    world = build_world(load_world("scenario_1"))
    guide = Guide(world)
    for position in ([0.0, 0.0], [2.5, 0.3], [4.1, 0.0]):
        assert guide.remaining(position) == world.remaining(position)


def test_progress_grows_along_the_way_and_never_falls() -> None:
    world = corner()
    walk = np.array([(0, 0), (-0.5, 0), (1, 0.4), (0.8, 0.4), (1.9, 0), (2.0, 1.5), (2, 1.0), (2, 2.8)], dtype=float)
    total = 5.0 - 0.25
    expected = np.array([0, 0, 1, 1, 2, 3.5, 3.5, 4.8]) / total
    np.testing.assert_allclose(progress(world, walk)[:4], expected[:4])
    np.testing.assert_allclose(progress(world, walk)[5:7], expected[5:7])
    assert progress(world, walk)[-1] == 1.0
    assert (np.diff(progress(world, walk)) >= 0).all()


def test_a_circle_is_walked_all_around() -> None:
    world = build_world(load_world("hw_flat"))
    angles = np.linspace(-0.5 * np.pi, 1.5 * np.pi, 100)
    circle = 0.75 * np.column_stack([np.cos(angles), 1.0 + np.sin(angles)])
    guide = Guide(world)
    left = [guide.remaining(place) for place in circle]
    assert min(left[:90]) > 0.0 and left[-1] <= 0.0
    assert progress(world, circle)[0] < 1e-9 and progress(world, circle)[-1] == 1.0
