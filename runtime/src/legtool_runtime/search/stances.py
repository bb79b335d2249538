"""What a stance and a transition between two stances must keep to, and what the transition costs.

Equations 15 to 18 of QuadPiPS (section VI-C), signed, in the frame of the four feet: x from the middle of the hind feet
to that of the front feet, y to the left in the feet's plane. Beyond them are the rules that made plans walkable.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.search.settings import Walkability

Doubles = NDArray[np.float64]

#: What refuses a stance or a transition, by number.
RULES = (
    "", "reach (equation 15)", "swing distance (equation 18)", "stance width (equation 17)",
    "stance length (equation 17)", "skewed feet", "feet off their plane", "tilt of the feet's plane",
    "feet too close to each other", "feet too far from their hips", "torso off the line of the feet that bear (δ)",
    "turn in one transition", "support of the centre of mass", "inverse kinematics", "clearance of the shanks",
    "clearance of the trunk", "swing over what is in the way", "a transition that was refused before",
)  # fmt: skip
(
    _, REACH, SWING, WIDTH, LENGTH, SKEW, UNEVEN, TILT, APART, HIP, OFF_LINE, TURN, SUPPORT, KINEMATICS, SHANK, TRUNK,
    CORRIDOR, REFUSED,
) = range(len(RULES))  # fmt: skip
#: Where the entries of a shape begin: middle (3), heading (2), widths (2), lengths (2), skews (2), feet off their
#: plane, slopes of x and y (2), feet before their hips (4); and how many there are.
MIDDLE, HEADING, WIDTHS, LENGTHS, SKEWS, TWIST, SLOPES, HIPS, SHAPE = 0, 3, 5, 7, 9, 11, 12, 14, 18
#: Feet that still stand as at the start may exceed a limit by this more than they did there [m].
_WAIVED = 0.01
#: Weight of the swinging leg of a walk in the body's reference, as the tracker has it.
SWING_WEIGHT = 0.2
#: Smallest triangle of three feet that bear [m²].
_LEAST_AREA = 0.005


class Rules(NamedTuple):
    """:class:`.Walkability` for compiled code; ``centre`` (4, 3) of the superquadrics, ``hips`` (4,) x of the hips."""

    width: float
    width_off: float
    length: float
    length_off: float
    signed: bool
    swing: float
    swing_up: float
    swing_down: float
    semi_axes: Doubles
    exponent: int
    centre: Doubles
    hips: Doubles
    inverse_kinematics: bool
    hip_offset: Doubles
    off_line: float
    skew: float
    uneven: float
    tilt: float
    turn: float
    apart: float
    shank: float
    support: float
    apex: float
    trunk: float
    per_step_m: float
    turn_m: float
    climb_m: float
    off_line_m: float
    shape_m: float
    hip_m: float


def rules_of(walkability: Walkability, hips: Doubles) -> Rules:
    """The rules as compiled code reads them; ``hips`` (4, 3) base frame [m]."""
    w, mirror = walkability, np.array([[1, 1, 1], [1, -1, 1], [-1, 1, 1], [-1, -1, 1]], dtype=np.float64)
    return Rules(
        float(w.width), float(w.width_off), float(w.length), float(w.length_off), w.signed, float(w.swing),
        float(w.swing_up), float(w.swing_down), np.array(w.semi_axes, dtype=np.float64), w.exponent,
        np.array(w.centre, dtype=np.float64) * mirror, np.ascontiguousarray(hips[:, 0]), w.inverse_kinematics,
        np.array([w.hip_offset, w.hip_offset_walk], dtype=np.float64), float(w.off_line), float(w.skew),
        float(w.uneven), float(np.sin(min(w.tilt, 0.5 * np.pi))), float(w.turn), float(w.apart), float(w.shank),
        float(w.support), float(w.apex), float(w.trunk), float(w.per_step_m), float(w.turn_m), float(w.climb_m),
        float(w.off_line_m), float(w.shape_m), float(w.hip_m),
    )  # fmt: skip


@kernel
def shape_of(p: Doubles, hips: Doubles, out: Doubles) -> bool:
    """Write the shape (SHAPE,) of a stance with feet ``p`` (4, 3); False for feet that span no plane."""
    xx, xy, xz = 0.0, 0.0, 0.0
    for i in range(3):
        out[MIDDLE + i] = 0.25 * (p[0, i] + p[1, i] + p[2, i] + p[3, i])
    xx = 0.5 * (p[0, 0] + p[1, 0] - p[2, 0] - p[3, 0])
    xy = 0.5 * (p[0, 1] + p[1, 1] - p[2, 1] - p[3, 1])
    xz = 0.5 * (p[0, 2] + p[1, 2] - p[2, 2] - p[3, 2])
    flat, length = np.sqrt(xx * xx + xy * xy), np.sqrt(xx * xx + xy * xy + xz * xz)
    if flat < 0.02:
        return False
    out[HEADING], out[HEADING + 1] = xx / flat, xy / flat
    xx, xy, xz = xx / length, xy / length, xz / length
    yx = 0.5 * (p[0, 0] + p[2, 0] - p[1, 0] - p[3, 0])
    yy = 0.5 * (p[0, 1] + p[2, 1] - p[1, 1] - p[3, 1])
    yz = 0.5 * (p[0, 2] + p[2, 2] - p[1, 2] - p[3, 2])
    along = xx * yx + xy * yy + xz * yz
    yx, yy, yz = yx - along * xx, yy - along * xy, yz - along * xz
    length = np.sqrt(yx * yx + yy * yy + yz * yz)
    if length < 0.02:
        return False
    yx, yy, yz = yx / length, yy / length, yz / length
    if xx * yy - xy * yx < 0.0:  # left feet are right of the right ones: y points left all the same
        yx, yy, yz = -yx, -yy, -yz
    for k in range(2):
        a, b = 2 * k, 2 * k + 1
        dx, dy, dz = p[a, 0] - p[b, 0], p[a, 1] - p[b, 1], p[a, 2] - p[b, 2]
        out[WIDTHS + k] = yx * dx + yy * dy + yz * dz
        out[SKEWS + k] = abs(xx * dx + xy * dy + xz * dz)
        out[LENGTHS + k] = xx * (p[k, 0] - p[k + 2, 0]) + xy * (p[k, 1] - p[k + 2, 1]) + xz * (p[k, 2] - p[k + 2, 2])
    out[TWIST] = 0.25 * abs(p[0, 2] - p[1, 2] - p[2, 2] + p[3, 2])
    out[SLOPES], out[SLOPES + 1] = abs(xz), abs(yz)
    for leg in range(4):
        dx, dy, dz = p[leg, 0] - out[MIDDLE], p[leg, 1] - out[MIDDLE + 1], p[leg, 2] - out[MIDDLE + 2]
        out[HIPS + leg] = abs(xx * dx + xy * dy + xz * dz - hips[leg])
    return True


@kernel
def _off(value: float, ideal: float, most: float, signed: bool) -> float:
    """By how much a width or length is beyond its bounds; norms where it is not signed, as in equation 16."""
    return abs((value if signed else abs(value)) - ideal) - most


@kernel
def shape_fault(shape: Doubles, rules: Rules, single: int, start: Doubles, old: NDArray[np.bool_]) -> int:
    """Which rule a stance breaks; 0 for none.

    Args:
        shape: of the stance.
        rules: to keep.
        single: 1 where single legs swing, 0 where pairs do.
        start: shape of the stance at the start.
        old: (4,) which feet still stand as at the start: what they broke there they may break on.
    """
    for k in range(2):
        off = _off(shape[WIDTHS + k], rules.width, rules.width_off, rules.signed)
        if off > 1e-9 and not (
            (old[2 * k] or old[2 * k + 1])
            and off <= _off(start[WIDTHS + k], rules.width, rules.width_off, rules.signed) + _WAIVED
        ):
            return WIDTH
        off = _off(shape[LENGTHS + k], rules.length, rules.length_off, rules.signed)
        if off > 1e-9 and not (
            (old[k] or old[k + 2])
            and off <= _off(start[LENGTHS + k], rules.length, rules.length_off, rules.signed) + _WAIVED
        ):
            return LENGTH
        if shape[SKEWS + k] > rules.skew + 1e-9 and not (
            (old[2 * k] or old[2 * k + 1]) and shape[SKEWS + k] <= start[SKEWS + k] + _WAIVED
        ):
            return SKEW
        if shape[SLOPES + k] > rules.tilt + 1e-9:
            return TILT
    some = old[0] or old[1] or old[2] or old[3]
    if shape[TWIST] > rules.uneven + 1e-9 and not (some and shape[TWIST] <= start[TWIST] + _WAIVED):
        return UNEVEN
    for leg in range(4):
        if shape[HIPS + leg] > rules.hip_offset[single] + 1e-9 and not (
            some and shape[HIPS + leg] <= start[HIPS + leg] + _WAIVED
        ):
            return HIP
    return 0


@kernel
def turn_between(a: Doubles, b: Doubles) -> float:
    """Angle from the heading of one shape to that of another, -π to π [rad]."""
    cross = a[HEADING] * b[HEADING + 1] - a[HEADING + 1] * b[HEADING]
    return np.arctan2(cross, a[HEADING] * b[HEADING] + a[HEADING + 1] * b[HEADING + 1])


@kernel
def move_cost(before: Doubles, after: Doubles, turn: float, rules: Rules, single: int) -> float:
    """What a transition between two shapes costs, but for its footholds and δ [m].

    The torso's nominal place is over the middle of the four feet: its way is that of the middle (VI-C3).
    """
    dx, dy, dz = after[0] - before[0], after[1] - before[1], after[2] - before[2]
    cost = np.sqrt(dx * dx + dy * dy + dz * dz) + rules.turn_m * abs(turn) + rules.per_step_m
    if rules.shape_m > 0.0:
        for k in range(2):
            width = (after[WIDTHS + k] - rules.width) / rules.width_off
            length = (after[LENGTHS + k] - rules.length) / rules.length_off
            cost += rules.shape_m * (width * width + length * length)
    if rules.hip_m > 0.0:
        for leg in range(4):
            cost += 0.25 * rules.hip_m * (after[HIPS + leg] / rules.hip_offset[single]) ** 2
    return cost


@kernel
def in_reach(
    rules: Rules, leg: int, pose: Doubles, rotation: Doubles, height: float, x: float, y: float, z: float
) -> bool:
    """Equation 15: whether a place lies in a leg's superquadric about a pose (6,) whose base is ``height`` over the
    middle of the feet; the body's lowering for its legs' sake does not move it."""
    dx, dy, dz = x - pose[0], y - pose[1], z - height
    total = 0.0
    for i in range(3):
        inside = rotation[0, i] * dx + rotation[1, i] * dy + rotation[2, i] * dz
        share, power = abs(inside - rules.centre[leg, i]) / rules.semi_axes[i], 1.0
        if share > 1.0:
            return False
        for _ in range(rules.exponent):
            power *= share
        total += power
    return total <= 1.0


@kernel
def least_share(p: Doubles, swings: int, x: float, y: float) -> float:
    """Least barycentric coordinate of a place in the triangle of the three feet that bear; -1 for a narrow one."""
    a, b, c = (swings + 1) % 4, (swings + 2) % 4, (swings + 3) % 4
    ux, uy = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1]
    vx, vy = p[c, 0] - p[a, 0], p[c, 1] - p[a, 1]
    area = ux * vy - uy * vx
    if abs(area) < 2.0 * _LEAST_AREA:
        return -1.0
    wx, wy = x - p[a, 0], y - p[a, 1]
    second, third = (wx * vy - wy * vx) / area, (ux * wy - uy * wx) / area
    return min(min(second, third), 1.0 - second - third)
