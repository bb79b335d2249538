"""What the foothold networks are fed: the tuple of ViTAL, the same in training and on the robot.

Right legs are mirrored to left ones, so that one network serves both sides; heights and hip heights are taken above the
map's median. The vector holds the paper's inputs first, then what the criteria derive from them. Beside it the paper's
networks get a first guess, which they correct: what seems safe at a glance. The dense network is told where the foot
lifts off.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.foothold.criteria.criteria import Criteria
from legtool_runtime.foothold.gait import Gait, hip_velocity
from legtool_runtime.foothold.heightmap import nearest_safe
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE, hip_heights

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


#: What is encoded for: the paper's network of either task, or the dense one, which serves both.
Kind = Literal["vfa", "vpa", "dense"]
#: Hip heights of the safe-foothold function, see :func:`.settings.hip_heights`.
HIPS = 31


class Inputs(NamedTuple):
    """Inputs of a network for n tuples.

    Attributes:
        heights: (n, 1, 33, 33) above the median and mirrored [m], NaN where unknown.
        vector: (n, 27), unscaled.
        glance: the first guess of the paper's networks. For the VFA (n, 33, 33), mirrored: of the cells that seem safe,
            how near they are, from 1 in the middle down to 0 at a corner, and 1 more for the nearest. For the VPA
            (n, 2, 31): about how many footholds are safe over the hip heights above the median, after the erosion and
            before it, see :meth:`.criteria.Criteria.glance_counts`. None for the dense one.
        median: (n,) [m]; not fed.
    """

    heights: Array32
    vector: Array32
    glance: Array32 | None
    median: Array32

    def fed(self) -> dict[str, Array32]:
        """What is fed, by name."""
        fed = {"heights": self.heights, "vector": self.vector}
        return fed if self.glance is None else {**fed, "glance": self.glance}


def encode(
    criteria: Criteria,
    kind: Kind,
    *,
    heights: ArrayLike,
    leg: ArrayLike,
    hip_height: ArrayLike,
    base_twist: ArrayLike,
    gait: ArrayLike,
    nominal: ArrayLike,
    vpa: ArrayLike,
) -> Inputs:
    """Inputs of a network for n tuples.

    Args:
        criteria: of the robot whose legs they are.
        kind: for which network. The dense one's vector holds where the foot lifts off, for which a map below a hip is
            encoded for the hip of the standing robot, whatever its own; else these entries are zero.
        heights: (n, 33, 33) [m], NaN where unknown.
        leg: (n,).
        hip_height: (n,) [m], in the vertical frame of the heights.
        base_twist: (n, 6).
        gait: (n, 4) step length [m], frequency [Hz], duty factor, time to touchdown [s].
        nominal: (n, 2) the map's centre from below the hip [m].
        vpa: (n,) 1 where the map lies below the hip, and the nominal foothold follows from the twist; it does for all
            that are encoded for the VPA.
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
    out, median = np.empty((n, 1, SIZE, SIZE), np.float32), np.empty(n, np.float32)
    vector = np.empty((n, len(FEATURES)), np.float32)
    _encode(robot.hips, h, *columns, out, vector, median)
    shapes: dict[Kind, tuple[int, ...] | None] = {"vfa": (n, SIZE, SIZE), "vpa": (n, 2, HIPS), "dense": None}
    shape = shapes[kind]
    hips = hip_heights(robot, HIPS) if kind == "vpa" else np.empty(0)
    glance = None if shape is None else np.zeros(shape, np.float32)
    legs, z_h, twists, gaits, nominals, below = columns
    for k, side in enumerate(legs.tolist()):
        motion = {"leg": side, "base_twist": twists[k].tolist(), "gait": Gait(*gaits[k].tolist())}
        place, right = None if below[k] else nominals[k], side % 2 == 1
        if glance is None:
            hip = float(z_h[k])
            if below[k]:
                hip = float(median[k]) + robot.standing_height + float(robot.hips[side, 2])
            x, y, z = criteria.lift_off(h[k], hip_height=hip, nominal=place, **motion)
            vector[k, 0] = hip - median[k]
            vector[k, LIFT_OFF : LIFT_OFF + 3] = x, -y if right else y, z - median[k]
        elif kind == "vpa":
            glance[k] = criteria.glance_counts(h[k], hip_heights=hips + median[k], **motion)
        else:
            seems = criteria.glance(h[k], hip_height=float(z_h[k]), nominal=place, **motion)
            near = seems * NEARNESS
            nearest = nearest_safe(seems, hip_velocity(robot, side, motion["base_twist"]))
            if nearest is not None:
                near[nearest] += 1.0
            glance[k] = near[:, ::-1] if right else near
    return Inputs(out, vector, glance, median)


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
