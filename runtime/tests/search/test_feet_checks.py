"""What is looked at when a transition comes off the queue."""

import numpy as np
import pytest

from legtool_runtime.robot import Robot
from legtool_runtime.search.body import body_of, legs_fit, scratch, shanks_clear
from legtool_runtime.search.feet_checks import _swing_clears
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.ground import ground_of

#: Heights that a swing clears on its way, where it begins and where it ends; how far these reach [m].
LIMITS, RADIUS = (0.22, 0.05, 0.05, 0.04), 0.05


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


@pytest.mark.parametrize(("rise", "before", "clears"), [(0.14, 0.05, True), (0.25, 0.05, False), (0.25, 0.12, True)])
def test_a_low_riser_is_no_wall_and_a_high_one_is_kept_off(rise, before, clears):
    """A foot that stands right before a riser of 25 cm would be caught by it as it rises."""
    heights = np.zeros((120, 60), np.float32)
    heights[60:] = rise
    ground = ground_of(HeightMap(heights, 0.01, np.zeros(2)))
    low, high = np.array([-before, 0.0, 0.0]), np.array([0.10, 0.0, rise])
    up, down = min(rise + 0.05, 0.15), rise + 0.05
    assert _swing_clears(ground, low, high, RADIUS, (rise + 0.22, up, down, 0.04)) == clears
    assert _swing_clears(ground, high, low, RADIUS, (rise + 0.22, down, up, 0.04)) == clears


@pytest.mark.parametrize(("beside", "clears"), [(0.01, False), (0.025, False), (0.055, True)])
def test_a_shank_keeps_off_what_stands_beside_it(anymal: Robot, beside, clears):
    """A knee leaned on the edge of a barrier a few centimetres beside its foot, and the foot lost the ground."""
    body, s = body_of(anymal), scratch()
    s.pose[:] = 0.0, 0.0, body.height, 0.0, 0.0, 0.0
    s.feet[:] = anymal.hips + np.outer(anymal.abduction_offset, [0, 1, 0])
    s.feet[:, 2] = 0.0
    assert legs_fit(body, np.ones(4, np.bool_), s)
    heights = np.full((120, 120), -body.radius, np.float32)
    left = (np.arange(120) + 0.5) * 0.02 - 1.2
    heights[:, left > s.feet[2, 1] + beside] = 0.12
    ground = ground_of(HeightMap(heights, 0.02, np.zeros(2)))
    assert shanks_clear(body, ground, ground_of(None), 0.03, s) == clears
