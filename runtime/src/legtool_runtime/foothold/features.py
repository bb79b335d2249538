"""What the foothold networks are fed: the tuple of ViTAL, the same in training and on the robot.

Right legs are mirrored to left ones, and the trunk's roll with them, so that one network serves both sides; heights and
hip heights are taken above the map's median. The vector holds the paper's inputs and the trunk's attitude first, then
what the criteria derive from them. Beside it the paper's networks get a coarse check by the criteria, which they
correct. The dense network is told where the foot lifts off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.foothold.criteria.criteria import Criteria
from legtool_runtime.foothold.gait import hip_velocity
from legtool_runtime.foothold.heightmap import nearest_safe
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE, hip_heights
from legtool_runtime.foothold.tuples import Tuple
from legtool_runtime.robot import Robot

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

#: Names of the vector's entries, and a typical size of each, by which networks divide.
FEATURES: tuple[tuple[str, float], ...] = (
    ("hip_height_m", 0.3),
    *((f"velocity_{axis}", 0.4) for axis in "xyz"),
    *((f"rate_{axis}", 0.3) for axis in "xyz"),
    ("step_length_m", 0.3),
    ("step_frequency_hz", 1.5),
    ("duty_factor", 0.6),
    ("time_to_touchdown_s", 0.3),
    ("nominal_x_m", 0.2),
    ("nominal_y_m", 0.2),
    ("hind", 1.0),
    ("roll", 0.3),
    ("pitch", 0.3),
    ("hip_x_m", 0.2),
    ("hip_y_m", 0.2),
    *((f"hip_velocity_{axis}", 0.4) for axis in "xyz"),
    ("lift_off_x_m", 0.2),
    ("lift_off_y_m", 0.2),
    ("lift_off_z_m", 0.2),
    ("swing_s", 0.3),
    ("stance_s", 0.4),
    ("swing_phase", 0.5),
    ("direction_x", 1.0),
    ("direction_y", 1.0),
)
#: Where the foot lifts off in the vector: three entries.
LIFT_OFF = [name for name, _ in FEATURES].index("lift_off_x_m")
#: (33, 33) how near to a map's middle its cells are: 1 there, 0 at the corners.
NEARNESS = (1.0 - np.hypot(*np.mgrid[-1 : 1 : SIZE * 1j, -1 : 1 : SIZE * 1j]) / np.sqrt(2.0)).astype(np.float32)
#: The paper's own inputs (appendix A), whether the leg is a hind one, and the trunk's attitude.
PAPER = 16


#: What is encoded for: the paper's network of either task, or the dense one, which serves both.
Kind = Literal["vfa", "vpa", "dense"]
#: Hip heights of the safe-foothold function, see :func:`.settings.hip_heights`.
HIPS = 31
#: The name that the coarse check has in the files of networks.
COARSE_INPUT = "glance"


class Inputs(NamedTuple):
    """Inputs of a network for n tuples.

    Attributes:
        heights: (n, 1, 33, 33) above the median and mirrored [m], NaN where unknown.
        vector: (n, 29), unscaled.
        coarse: the coarse check that the paper's networks correct. For the VFA (n, 33, 33), mirrored: of the cells that
            seem safe, how near they are, from 1 in the middle down to 0 at a corner, and 1 more for the nearest. For
            the VPA (n, 2, 31): about how many footholds are safe over the hip heights above the median, after the
            erosion and before it, see :meth:`.criteria.Criteria.coarse_counts`. None for the dense one.
        median: (n,) [m]; not fed.
    """

    heights: Array32
    vector: Array32
    coarse: Array32 | None
    median: Array32

    def fed(self) -> dict[str, Array32]:
        """What is fed, by name."""
        fed = {"heights": self.heights, "vector": self.vector}
        return fed if self.coarse is None else {**fed, COARSE_INPUT: self.coarse}


class _Columns(NamedTuple):
    """What tuples hold beside their maps, a row each, as the kernel takes it; ``below``: the map lies below the hip."""

    leg: NDArray[np.int64]
    hip_height: Array
    twist: Array
    gait: Array
    nominal: Array
    below: NDArray[np.int64]
    attitude: Array


def encode(criteria: Criteria, kind: Kind, tuples: Sequence[Tuple]) -> Inputs:
    """Inputs of a network for n tuples.

    Args:
        criteria: of the robot whose legs they are.
        kind: for which network. The dense one's vector holds where the foot lifts off, for which a map below a hip is
            encoded for the hip of the standing robot, whatever its own; else these entries are zero.
        tuples: to encode. For the VPA their maps lie below the hips, and their hip heights are not looked at.

    Raises:
        StateError: a tuple without a hip height, though the network is told of one.
    """
    n, robot = len(tuples), criteria.robot
    h = np.array([t.heights for t in tuples], np.float32).reshape(n, SIZE, SIZE)
    columns = _columns(tuples)
    out, median = np.empty((n, 1, SIZE, SIZE), np.float32), np.empty(n, np.float32)
    vector = np.empty((n, len(FEATURES)), np.float32)
    _encode(robot.hips, h, columns, out, vector, median)
    if kind == "dense":
        for k, t in enumerate(tuples):
            standing = t if t.nominal is not None else _standing(robot, t, float(median[k]))
            x, y, z = criteria.lift_off(standing)
            assert standing.hip_height is not None
            vector[k, 0] = standing.hip_height - median[k]
            vector[k, LIFT_OFF : LIFT_OFF + 3] = x, -y if t.leg % 2 == 1 else y, z - median[k]
        return Inputs(out, vector, None, median)
    if kind == "vpa":
        hips = hip_heights(robot, HIPS)
        counts = [criteria.coarse_counts(t, hips + m) for t, m in zip(tuples, median, strict=True)]
        return Inputs(out, vector, np.array(counts, np.float32).reshape(n, 2, HIPS), median)
    near = [_nearness(criteria, t) for t in tuples]
    return Inputs(out, vector, np.array(near, np.float32).reshape(n, SIZE, SIZE), median)


def _standing(robot: Robot, t: Tuple, ground: float) -> Tuple:
    """The tuple with the hip where it is when the robot stands on ground of a height [m]."""
    return replace(t, hip_height=ground + robot.standing_height + float(robot.hips[t.leg, 2]))


def _nearness(criteria: Criteria, t: Tuple) -> Array32:
    """(33, 33) the coarse check of one map as the VFA's network takes it."""
    seems = criteria.coarse(t)
    near = seems * NEARNESS
    nearest = nearest_safe(seems, hip_velocity(criteria.robot, t.leg, t.base_twist, roll=t.roll, pitch=t.pitch))
    if nearest is not None:
        near[nearest] += 1.0
    return near[:, ::-1] if t.leg % 2 == 1 else near


def _columns(tuples: Sequence[Tuple]) -> _Columns:
    n = len(tuples)
    gaits = [
        (t.gait.step_length_m, t.gait.step_frequency_hz, t.gait.duty_factor, t.gait.time_to_touchdown_s) for t in tuples
    ]
    return _Columns(
        np.array([t.leg for t in tuples], np.int64),
        np.array([0.0 if t.hip_height is None else t.hip_height for t in tuples], np.float64),
        np.array([t.base_twist for t in tuples], np.float64).reshape(n, 6),
        np.array(gaits, np.float64).reshape(n, 4),
        np.array([(0.0, 0.0) if t.nominal is None else t.nominal for t in tuples], np.float64).reshape(n, 2),
        np.array([t.nominal is None for t in tuples], np.int64),
        np.array([(t.roll, t.pitch) for t in tuples], np.float64).reshape(n, 2),
    )


@kernel
def _encode(hips: Array, heights: Array32, columns: _Columns, out: Array32, vector: Array32, median: Array32) -> None:
    leg, hip_height, twist = columns.leg, columns.hip_height, columns.twist
    gait, nominal, below = columns.gait, columns.nominal, columns.below
    size = heights.shape[1]
    known = np.empty(size * size, np.float32)
    for n in range(leg.shape[0]):
        count = 0
        for i in range(size):
            for j in range(size):
                value = heights[n, i, j]
                if value == value:
                    known[count] = value
                    count += 1
        middle = np.partition(known[:count], count // 2)[count // 2] if count > 0 else np.float32(0.0)
        median[n] = middle
        right = leg[n] % 2 == 1
        side = -1.0 if right else 1.0
        for i in range(size):
            for j in range(size):
                out[n, 0, i, j] = heights[n, i, size - 1 - j if right else j] - middle
        hip = hips[leg[n]]
        v = vector[n]
        v[0] = hip_height[n] - middle
        vx, vy, vz = twist[n, 0], side * twist[n, 1], twist[n, 2]
        wx, wy, wz = side * twist[n, 3], twist[n, 4], side * twist[n, 5]
        v[1], v[2], v[3], v[4], v[5], v[6] = vx, vy, vz, wx, wy, wz
        length, frequency, duty = gait[n, 0], gait[n, 1], gait[n, 2]
        swing, standing = (1.0 - duty) / frequency, duty / frequency
        left = min(gait[n, 3], swing)
        v[7], v[8], v[9], v[10] = length, frequency, duty, left
        roll, pitch = side * columns.attitude[n, 0], columns.attitude[n, 1]
        cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
        lifted = sr * side * hip[1] + cr * hip[2]
        x, y, z = cp * hip[0] + sp * lifted, cr * side * hip[1] - sr * hip[2], cp * lifted - sp * hip[0]
        ux, uy, uz = vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x
        hip_x, hip_y = -nominal[n, 0], -side * nominal[n, 1]
        if below[n] != 0:
            hip_x, hip_y = 0.0, 0.0
        v[11], v[12], v[13] = -hip_x, -hip_y, 1.0 if leg[n] >= 2 else 0.0
        speed = np.sqrt(ux * ux + uy * uy)
        along_x, along_y = (ux / speed, uy / speed) if speed > 1e-3 else (0.0, 0.0)
        v[14], v[15] = roll, pitch
        v[16], v[17], v[18], v[19], v[20] = hip_x, hip_y, ux, uy, uz
        v[21], v[22], v[23] = 0.0, 0.0, 0.0
        v[24], v[25], v[26], v[27], v[28] = swing, standing, 1.0 - left / swing, along_x, along_y


def unmirror(cells: ArrayLike, leg: ArrayLike) -> NDArray[np.int64]:
    """Cell numbers ix · 33 + iy in the map as given, for cells in the mirrored one; -1 stays."""
    number, right = np.asarray(cells, dtype=np.int64), np.asarray(leg) % 2 == 1
    ix, iy = np.divmod(number, SIZE)
    return np.where(number < 0, -1, ix * SIZE + np.where(right, SIZE - 1 - iy, iy))


def cell_centers() -> Array32:
    """(2, 33, 33) x and y of the cells from the map's centre [m]."""
    axis = (np.arange(SIZE, dtype=np.float32) - SIZE // 2) * np.float32(RESOLUTION_M)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"))
