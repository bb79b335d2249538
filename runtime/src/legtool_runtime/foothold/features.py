"""What the foothold networks are fed: the tuple of ViTAL, the same in training and on the robot.

Right legs are mirrored to left ones, so that one network serves both sides; heights and hip heights are taken above the
map's median. The vector holds the paper's inputs first, then what the criteria derive from them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE
from legtool_runtime.robot import Robot

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
    ("swing_s", 0.3),
    ("stance_s", 0.4),
    ("swing_phase", 0.5),
    ("direction_x", 1.0),
    ("direction_y", 1.0),
)
#: The paper's own inputs (appendix A), and whether the leg is a hind one.
PAPER = 14


def encode(
    robot: Robot,
    *,
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
        robot: whose legs they are.
        heights: (n, 33, 33) [m], NaN where unknown.
        leg: (n,).
        hip_height: (n,) [m], in the vertical frame of the heights.
        base_twist: (n, 6).
        gait: (n, 4) step length [m], frequency [Hz], duty factor, time to touchdown [s].
        nominal: (n, 2) the map's centre from below the hip [m].
        vpa: (n,) 1 where the map lies below the hip, and the nominal foothold follows from the twist.

    Returns:
        heights (n, 1, 33, 33) above the median and mirrored; the vector (n, 26), unscaled; the medians (n,) [m].
    """
    h = np.array(heights, dtype=np.float32)
    legs = np.asarray(leg, dtype=np.intp)
    right = legs % 2 == 1
    side = np.where(right, -1.0, 1.0)
    median = np.array([_median(one) for one in h], dtype=np.float32)
    h -= median[:, None, None]
    h[right] = h[right][:, :, ::-1]
    twist = np.array(base_twist, dtype=np.float64)
    twist[:, [1, 3, 5]] *= side[:, None]
    alpha = np.array(gait, dtype=np.float64)
    swing, stance = (1 - alpha[:, 2]) / alpha[:, 1], alpha[:, 2] / alpha[:, 1]
    alpha[:, 3] = np.minimum(alpha[:, 3], swing)
    hips = robot.hips[legs] * np.stack([np.ones_like(side), side, np.ones_like(side)], axis=1)
    rest = (robot.stance[legs] - robot.hips[legs])[:, :2] * np.stack([np.ones_like(side), side], axis=1)
    velocity = twist[:, :3] + np.cross(twist[:, 3:], hips)
    below = np.asarray(vpa, dtype=bool)[:, None]
    given = np.array(nominal, dtype=np.float64) * np.stack([np.ones_like(side), side], axis=1)
    hip = np.where(below, 0.0, -given)
    foot = np.where(below, rest + 0.5 * stance[:, None] * velocity[:, :2], 0.0)
    speed = np.linalg.norm(velocity[:, :2], axis=1)
    direction = np.where(speed[:, None] > 1e-3, velocity[:, :2] / np.maximum(speed, 1e-9)[:, None], 0.0)
    lift = foot - alpha[:, :1] * direction
    vector = np.column_stack(
        [
            np.asarray(hip_height) - median, twist, alpha, np.where(below, 0.0, given), legs >= 2, hip, velocity, lift,
            swing, stance, 1 - alpha[:, 3] / swing, direction,
        ]
    )  # fmt: skip
    return h[:, None], vector.astype(np.float32), median


def unmirror(cells: ArrayLike, leg: ArrayLike) -> NDArray[np.int64]:
    """Cell numbers ix · 33 + iy in the map as given, for cells in the mirrored one; -1 stays."""
    number, right = np.asarray(cells, dtype=np.int64), np.asarray(leg) % 2 == 1
    ix, iy = np.divmod(number, SIZE)
    return np.where(number < 0, -1, ix * SIZE + np.where(right, SIZE - 1 - iy, iy))


def cell_centers() -> Array32:
    """(2, 33, 33) x and y of the cells from the map's centre [m]."""
    axis = (np.arange(SIZE, dtype=np.float32) - SIZE // 2) * np.float32(RESOLUTION_M)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"))


def _median(heights: Array32) -> float:
    known = heights[~np.isnan(heights)]
    if known.size == 0:
        return 0.0
    return float(np.partition(known, known.size // 2)[known.size // 2])
