"""What the foothold networks are fed: the tuple of ViTAL, the same in training and on the robot.

Right legs are mirrored to left ones, so that one network serves both sides; heights and hip heights are taken above the
map's median. The vector holds the paper's inputs first, then what the criteria derive from them. Beside the heights the
paper's networks see which cells the cheap criteria allow; the dense network is told where the foot lifts off.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.foothold.criteria import Criteria
from legtool_runtime.foothold.gait import Gait, hip_velocity
from legtool_runtime.foothold.heightmap import nearest_safe
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE

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
#: The paper's own inputs (appendix A), and whether the leg is a hind one.
PAPER = 14


def encode(
    criteria: Criteria,
    *,
    dense: bool,
    heights: ArrayLike,
    leg: ArrayLike,
    hip_height: ArrayLike,
    base_twist: ArrayLike,
    gait: ArrayLike,
    nominal: ArrayLike,
    vpa: ArrayLike,
) -> tuple[Array32, Array32, Array32]:
    """Inputs of the networks for n tuples.

    Args:
        criteria: of the robot whose legs they are.
        dense: for the dense network: the vector holds where the foot lifts off, for which a map below a hip is encoded
            for the hip of the standing robot, whatever its own. Else those entries are zero, and a second channel tells
            the cells that :meth:`Criteria.allowed` allows: around nominal footholds how near they are, from 1 in the
            middle down to 0 at a corner, and 1 more for the nearest; below hips 1 for all that are not too rough.
        heights: (n, 33, 33) [m], NaN where unknown.
        leg: (n,).
        hip_height: (n,) [m], in the vertical frame of the heights.
        base_twist: (n, 6).
        gait: (n, 4) step length [m], frequency [Hz], duty factor, time to touchdown [s].
        nominal: (n, 2) the map's centre from below the hip [m].
        vpa: (n,) 1 where the map lies below the hip, and the nominal foothold follows from the twist.

    Returns:
        heights (n, 1 or 2, 33, 33) above the median and mirrored; the vector (n, 27), unscaled; the medians (n,) [m].
    """
    n, robot = len(np.asarray(leg)), criteria.robot
    columns = (
        np.ascontiguousarray(leg, dtype=np.int64),
        np.ascontiguousarray(hip_height, dtype=np.float64),
        np.ascontiguousarray(base_twist, dtype=np.float64).reshape(n, 6),
        np.ascontiguousarray(gait, dtype=np.float64).reshape(n, 4),
        np.ascontiguousarray(nominal, dtype=np.float64).reshape(n, 2),
        np.ascontiguousarray(vpa, dtype=np.int64),
    )
    h = np.ascontiguousarray(heights, dtype=np.float32)
    out, median = np.empty((n, 1 if dense else 2, SIZE, SIZE), np.float32), np.empty(n, np.float32)
    vector = np.empty((n, len(FEATURES)), np.float32)
    _encode(robot.hips, h, *columns, out, vector, median)
    legs, z_h, twists, gaits, nominals, below = columns
    for k, side in enumerate(legs):
        motion = {"leg": int(side), "base_twist": twists[k], "gait": Gait(*gaits[k].tolist())}
        place = None if below[k] else nominals[k]
        right = side % 2 == 1
        if dense:
            hip = median[k] + robot.standing_height + robot.hips[side, 2] if below[k] else z_h[k]
            x, y, z = criteria.lift_off(h[k], hip_height=hip, nominal=place, **motion)
            vector[k, 0] = hip - median[k]
            vector[k, LIFT_OFF : LIFT_OFF + 3] = x, -y if right else y, z - median[k]
        else:
            allowed = criteria.allowed(h[k], hip_height=None if below[k] else z_h[k], nominal=place, **motion)
            weighted = allowed if below[k] else allowed * NEARNESS
            nearest = None if below[k] else nearest_safe(allowed, hip_velocity(robot, int(side), twists[k]))
            if nearest is not None:
                weighted[nearest] += 1.0
            out[k, 1] = weighted[:, ::-1] if right else weighted
    return out, vector, median


@kernel
def _encode(
    hips: Array,
    heights: Array32,
    leg: NDArray[np.int64],
    hip_height: Array,
    twist: Array,
    gait: Array,
    nominal: Array,
    vpa: NDArray[np.int64],
    out: Array32,
    vector: Array32,
    median: Array32,
) -> None:
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
        x, y, z = hip[0], side * hip[1], hip[2]
        ux, uy, uz = vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x
        hip_x, hip_y = -nominal[n, 0], -side * nominal[n, 1]
        if vpa[n] != 0:
            hip_x, hip_y = 0.0, 0.0
        v[11], v[12], v[13] = -hip_x, -hip_y, 1.0 if leg[n] >= 2 else 0.0
        speed = np.sqrt(ux * ux + uy * uy)
        along_x, along_y = (ux / speed, uy / speed) if speed > 1e-3 else (0.0, 0.0)
        v[14], v[15], v[16], v[17], v[18] = hip_x, hip_y, ux, uy, uz
        v[19], v[20], v[21] = 0.0, 0.0, 0.0
        v[22], v[23], v[24], v[25], v[26] = swing, standing, 1.0 - left / swing, along_x, along_y


def unmirror(cells: ArrayLike, leg: ArrayLike) -> NDArray[np.int64]:
    """Cell numbers ix · 33 + iy in the map as given, for cells in the mirrored one; -1 stays."""
    number, right = np.asarray(cells, dtype=np.int64), np.asarray(leg) % 2 == 1
    ix, iy = np.divmod(number, SIZE)
    return np.where(number < 0, -1, ix * SIZE + np.where(right, SIZE - 1 - iy, iy))


def cell_centers() -> Array32:
    """(2, 33, 33) x and y of the cells from the map's centre [m]."""
    axis = (np.arange(SIZE, dtype=np.float32) - SIZE // 2) * np.float32(RESOLUTION_M)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"))
