"""What is looked at when a transition comes off the queue."""

import numpy as np
import pytest

from legtool_runtime.search.feet_checks import _swing_clears
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.ground import ground_of

#: Heights over the higher end that a swing clears on its way, and near its ends; how far these reach [m].
LIMITS, RADIUS = (0.22, 0.05, 0.04), 0.05


def wall(at, height, thick=0.02):
    """Level ground with a wall across the way of the swing, in cells of 1 cm."""
    heights = np.zeros((120, 60), np.float32)
    centre = (np.arange(120) + 0.5) * 0.01 - 0.6
    heights[np.abs(centre - at) <= 0.5 * thick] = height
    return ground_of(HeightMap(heights, 0.01, np.zeros(2)))


@pytest.mark.parametrize(
    ("at", "height", "clears"),
    [
        (0.0, 0.14, True),  # in the middle of the way, where the swing is high
        (0.0, 0.24, False),
        (-0.14, 0.14, False),  # 6 cm from where the foot lifts off
        (0.14, 0.14, False),  # and from where it lands
        (-0.07, 0.14, True),
        (-0.14, 0.04, True),  # it rises at once
        (-0.23, 0.14, False),  # behind the foot, within its radius
        (-0.30, 0.14, True),
    ],
)
def test_a_swing_is_high_in_the_middle_of_its_way_only(at, height, clears):
    a, b = np.array([-0.2, 0.0, 0.0]), np.array([0.2, 0.0, 0.0])
    for first, last in ((a, b), (b, a)):
        assert _swing_clears(wall(at, height), first, last, RADIUS, LIMITS) == clears


def test_a_step_up_is_no_wall():
    heights = np.zeros((120, 60), np.float32)
    heights[60:] = 0.14
    ground = ground_of(HeightMap(heights, 0.01, np.zeros(2)))
    low, high = np.array([-0.05, 0.0, 0.0]), np.array([0.10, 0.0, 0.14])
    limits = (0.14 + LIMITS[0], 0.14 + LIMITS[1], LIMITS[2])
    assert _swing_clears(ground, low, high, RADIUS, limits) and _swing_clears(ground, high, low, RADIUS, limits)
