"""Samples of one signal, and their conversion from the form in the log to SI units, our leg order and quaternions."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.configs.topics import CommandSignal, Joints, LegSignal, Orientation, Position, Signal
from legtool.datasets.logs.jointnames import joint_order
from legtool.errors import LogError
from legtool_runtime.robot import JOINTS, LEGS
from legtool_runtime.rotations import multiply, quaternion_from_angles, quaternion_of, to_world

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

#: Numbers in one sample of each signal, as a log holds it (a rotation matrix has 9).
WIDTH = {
    "position": 3,
    "orientation": 4,
    "velocity": 3,
    "yaw_rate": 1,
    "command": 3,
    "feet": 12,
    "joints": 12,
    "contact": 4,
    "swing": 2,
}
_SCALE = {
    "m": 1.0, "cm": 1e-2, "mm": 1e-3, "m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3,
    "rad": 1.0, "deg": np.pi / 180, "rad/s": 1.0, "deg/s": np.pi / 180,
}  # fmt: skip
#: A quaternion or rotation matrix that deviates more than this from unit length or orthonormality is damaged.
UNIT_TOLERANCE = 0.01
#: Samples that come up to this late are sorted in; a log whose stamps go back further is refused [ns].
MAX_LATE_NS = 1_000_000_000


class Samples(NamedTuple):
    """A stretch of one stream: stamps (n,) [ns], values (n, k) in SI units, our leg order, quaternions w, x, y, z."""

    stamps_ns: Stamps
    values: Array


def width(name: str, signal: Signal) -> int:
    """Return how many numbers the log contains for one sample."""
    if isinstance(signal, Orientation):
        return {"matrix": 9, "rpy": 3, "ypr": 3}.get(signal.order, WIDTH[name])
    return WIDTH[name]


def to_si(signal: Signal, raw: Array, where: Callable[[int], str]) -> Array:
    """Convert logged values.

    Args:
        signal: its unit and orders.
        raw: (n, k) values as logged.
        where: returns the name of row i of ``raw`` for an error message.

    Returns:
        (n, k) SI units; legs FL, FR, RL, RR; orientation as unit quaternion w, x, y, z; swing as one column, the index
        of the pair that has just swung or -1.

    Raises:
        LogError: a value is not finite, or an orientation is not a rotation.
    """
    finite = np.isfinite(raw).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        bad = raw[row][~np.isfinite(raw[row])][0]
        raise LogError(f"{where(row)}: holds {bad}, expected a finite number; cut this stretch from the log")
    scale = _SCALE[getattr(signal, "unit", "m")]
    values = raw if scale == 1.0 else raw * scale
    if isinstance(signal, CommandSignal) and signal.yaw_unit == "deg/s":
        values = values * [1.0, 1.0, _SCALE["deg/s"]]
    if isinstance(signal, Joints) and signal.order == "joint":
        values = values.reshape(len(values), 3, 4).swapaxes(1, 2).reshape(len(values), 12)
    elif isinstance(signal, Joints) and isinstance(signal.order, tuple):
        return np.ascontiguousarray(values[:, _by_name(signal.order)])
    if isinstance(signal, LegSignal) and signal.legs != LEGS and values.shape[1] >= 4:
        order = [signal.legs.index(leg) for leg in LEGS]
        values = values.reshape(len(values), 4, -1)[:, order].reshape(len(values), -1)
    if isinstance(signal, Orientation):
        values = _quaternions(signal, values, where)
    return np.ascontiguousarray(values)


def _by_name(names: tuple[str, ...]) -> list[int]:
    order = joint_order(list(names), ())
    if order is None or len(names) != len(LEGS) * len(JOINTS):
        raise LogError(
            f"joints: order {list(names)} does not name twelve joints; expected such as FL_hip, FL_thigh, FL_knee"
        )
    return order


def lost_rows(signal: Signal, raw: Array) -> NDArray[np.bool_]:
    """Rows (n,) that say that there is no value: not a number, or an orientation of length 0 (lost motion capture)."""
    lost = np.asarray(np.isnan(raw).any(axis=1), dtype=np.bool_)
    if isinstance(signal, Orientation) and raw.shape[1] > 3:
        lost |= (np.abs(raw) < 1e-9).all(axis=1)
    return lost


def swing_pairs(flags: Array, where: Callable[[int], str]) -> Array:
    """Return the pair that has just swung, (n, 1): 0 for FL+RR, 1 for FR+RL, -1 where neither flag is set.

    Raises:
        LogError: a flag is neither 0 nor 1, or both are set.
    """
    wrong = ((flags != 0) & (flags != 1)).any(axis=1) | (flags == 1).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(f"{where(row)}: swing flags are {flags[row].tolist()}, expected at most one of the two set")
    return np.where(flags[:, :1] == 1, 0.0, np.where(flags[:, 1:] == 1, 1.0, -1.0))


def check_stamps(stamps: Stamps, previous: int | None, max_jump_ns: int, where: Callable[[int], str]) -> None:
    """Reject stamps that go back by more than a second, or jump; what is late by less is sorted in later.

    Args:
        stamps: (n,) of one stream [ns].
        previous: the latest stamp before them, if there is one [ns].
        max_jump_ns: longest step forward [ns].
        where: returns the name of row i for an error message.

    Raises:
        LogError: there is such a stamp; the message names the first one.
    """
    before = np.maximum.accumulate(np.concatenate([stamps[:1] if previous is None else [np.int64(previous)], stamps]))
    steps = stamps - before[:-1]
    wrong = (steps < -MAX_LATE_NS) | (steps > max_jump_ns)
    if not wrong.any():
        return
    row = int(np.argmax(wrong))
    what = "goes back by" if steps[row] < 0 else "jumps ahead by"
    raise LogError(
        f"{where(row)}: the time {what} {abs(int(steps[row])) / 1e9:.6g} s, to {stamps[row] / 1e9:.6f} s; expected it "
        "to increase steadily; split the log there, or correct its stamps"
    )


def trunk_position(signal: Position, position: Array, orientation: Array) -> Array:
    """Return the origin of the trunk (n, 3), world frame [m], from the pose of the tracked body (w, x, y, z)."""
    if not any(signal.offset):
        return position
    return position + to_world(orientation, np.broadcast_to(np.array(signal.offset), position.shape))


def trunk_orientation(signal: Orientation, orientation: Array) -> Array:
    """Return the orientation (n, 4) of the trunk from that of the tracked body."""
    if not any(signal.mount):
        return orientation
    return multiply(orientation, quaternion_from_angles(*signal.mount))


def _quaternions(signal: Orientation, values: Array, where: Callable[[int], str]) -> Array:
    if signal.order in ("rpy", "ypr"):
        roll, pitch, yaw = (values if signal.order == "rpy" else values[:, ::-1]).T / 2
        turns = [np.zeros((len(values), 4)) for _ in range(3)]
        for axis, (turn, angle) in enumerate(zip(turns, (roll, pitch, yaw), strict=True)):
            turn[:, 0], turn[:, axis + 1] = np.cos(angle), np.sin(angle)
        return multiply(turns[2], multiply(turns[1], turns[0]))
    if signal.order == "matrix":
        return _from_matrices(values.reshape(-1, 3, 3), where)
    if signal.order == "xyzw":
        values = values[:, [3, 0, 1, 2]]
    norm = np.linalg.norm(values, axis=1)
    error = np.abs(norm - 1.0)
    if (error > UNIT_TOLERANCE).any():
        row = int(np.argmax(error > UNIT_TOLERANCE))
        raise LogError(
            f"{where(row)}: the quaternion has length {norm[row]:.4g}, expected 1; "
            "check which fields or columns hold the orientation"
        )
    # Rounded text is normalised to unit length; a quaternion that is already exact is left unchanged.
    return np.where(error[:, None] > 1e-12, values / norm[:, None], values)


def _from_matrices(matrices: Array, where: Callable[[int], str]) -> Array:
    error = np.abs(matrices @ matrices.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
    wrong = (error > UNIT_TOLERANCE) | (np.linalg.det(matrices) < 0)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(f"{where(row)}: the matrix is not a rotation (its rows are off orthonormal by {error[row]:.3g})")
    return quaternion_of(matrices)
