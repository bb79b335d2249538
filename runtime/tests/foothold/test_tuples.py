from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from legtool_runtime.errors import MapError, StateError
from legtool_runtime.foothold import Gait, Tuple

GOOD = dict(leg=1, hip_height=0.56, base_twist=(0.3, 0.0, 0.0, 0.0, 0.0, 0.1), gait=Gait(), nominal=(0.05, -0.03))
FLAT = np.zeros((33, 33))


def test_a_tuple_holds_plain_values_of_its_own():
    heights = np.arange(33.0 * 33).reshape(33, 33).T
    t = Tuple(heights, **{**GOOD, "base_twist": np.array(GOOD["base_twist"]), "nominal": np.array(GOOD["nominal"])})
    assert t.heights.dtype == np.float32 and t.heights.flags.c_contiguous
    assert t.base_twist == GOOD["base_twist"] and t.nominal == GOOD["nominal"]
    heights[:] = -1
    assert t.heights[2, 1] == 1 * 33 + 2
    with pytest.raises(FrozenInstanceError):
        t.leg = 2
    assert (t.roll, t.pitch) == (0.0, 0.0)
    steep = replace(t, roll=np.float32(-1.0), pitch=1)
    assert (steep.roll, steep.pitch) == (-1.0, 1.0) and type(steep.roll) is type(steep.pitch) is float


def test_the_hip_is_above_the_map_where_the_nominal_foothold_says():
    heights = np.zeros((33, 33))
    heights[16 - 2, 16 + 1] = 0.3
    t = Tuple(heights, **{**GOOD, "nominal": (0.04, -0.02)})
    assert t.hip == (-0.04, 0.02) and t.ground == pytest.approx(0.3)
    below = replace(t, nominal=None)
    assert below.hip == (0.0, 0.0) and below.ground == 0.0
    assert replace(t, nominal=(0.9, 0.9)).ground == 0.0  # off the map: its nearest cell


@pytest.mark.parametrize(
    ("heights", "changes", "error", "said"),
    [
        (np.zeros((40, 40)), {}, MapError, r"\(40, 40\).*expected \(33, 33\) at 0.02 m; cut one with"),
        (FLAT, {"resolution_m": 0.04}, MapError, r"at 0\.04 m: expected"),
        (np.full((33, 33), np.inf), {}, MapError, "mark unknown cells by NaN"),
        (np.full((33, 33), "a"), {}, MapError, "expected numbers"),
        (FLAT, {"leg": 7}, StateError, "leg is 7, expected 0 to 3 for FL, FR, RL, RR"),
        (FLAT, {"base_twist": (0.1, 0.2)}, StateError, "base twist .*expected six numbers"),
        (FLAT, {"base_twist": (np.nan,) * 6}, StateError, "base twist .*within ±10 m/s"),
        (FLAT, {"nominal": (3.0, 0.0)}, StateError, "within 2 m"),
        (FLAT, {"nominal": (np.nan, 0.0)}, StateError, "expected finite"),
        (FLAT, {"roll": 1.01}, StateError, r"roll 1\.01, pitch 0\.0 of the trunk: expected each within ±1 rad"),
        (FLAT, {"pitch": -1.01}, StateError, r"pitch -1\.01 of the trunk"),
        (FLAT, {"roll": np.nan}, StateError, "roll nan, pitch"),
        (FLAT, {"pitch": np.nan}, StateError, "pitch nan of the trunk"),
        (FLAT, {"hip_height": np.nan}, StateError, "hip height is nan, expected a finite number"),
    ],
)
def test_what_cannot_be_is_refused_when_the_tuple_is_built(heights, changes, error, said):
    with pytest.raises(error, match=said):
        Tuple(heights, **{**GOOD, **changes})
    with pytest.raises(StateError, match="hip height is inf"):
        replace(Tuple(FLAT, **GOOD), hip_height=np.inf)
