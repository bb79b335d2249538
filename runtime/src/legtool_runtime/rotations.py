"""Rotations, in one set of conventions for training, simulation and robot.

Quaternions are w, x, y, z of unit length and lead from the base to the world, as do matrices: columns are the base's
axes in the world. Roll, pitch and yaw are turns about x, y and z of the moved axes, R = Rz(yaw) Ry(pitch) Rx(roll); a
pitch above 0 is nose down. Angles are in radians. Leading dimensions (...) are kept. What is written here keeps its
order of operations: datasets are to have the same bits.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel

Array = NDArray[np.float64]


@kernel
def write_matrix(w: float, x: float, y: float, z: float, out: Array) -> None:
    """Write the matrix of a quaternion into ``out`` (3, 3)."""
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@kernel
def _write_matrices(quaternions: Array, out: Array) -> None:
    for n in range(len(quaternions)):
        q = quaternions[n]
        write_matrix(q[0], q[1], q[2], q[3], out[n])


def rotation_of(quaternion: ArrayLike) -> Array:
    """(..., 3, 3) matrices of unit quaternions (..., 4)."""
    q = np.array(quaternion, dtype=np.float64, order="C")  # always writable: one kind, one compiled kernel
    out = np.empty((*q.shape[:-1], 3, 3))
    _write_matrices(q.reshape(-1, 4), out.reshape(-1, 3, 3))
    return out


def quaternion_of(rotation: ArrayLike) -> Array:
    """(..., 4) quaternions of matrices (..., 3, 3)."""
    from scipy.spatial.transform import Rotation  # 0.1 s that few need wait for

    matrices = np.asarray(rotation, dtype=np.float64)
    found: Array = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat()[:, [3, 0, 1, 2]]
    return found.reshape(*matrices.shape[:-2], 4)


def from_angles(roll: float, pitch: float, yaw: float) -> Array:
    """(3, 3) matrix of roll, pitch and yaw."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def angles_of(rotation: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a matrix (3, 3), pitch within ±π/2."""
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    pitch = -math.asin(min(max(float(rotation[2, 0]), -1.0), 1.0))
    return roll, pitch, math.atan2(rotation[1, 0], rotation[0, 0])


def quaternion_from_angles(roll: float, pitch: float, yaw: float) -> Array:
    """(4,) quaternion of roll, pitch and yaw."""
    x = np.array([np.cos(roll / 2), np.sin(roll / 2), 0.0, 0.0])
    y = np.array([np.cos(pitch / 2), 0.0, np.sin(pitch / 2), 0.0])
    return multiply(quaternion_about_z(yaw), multiply(y, x))


def about_z(yaw: ArrayLike) -> Array:
    """(..., 3, 3) matrices of turns by yaws (...) about z."""
    angle = np.asarray(yaw, dtype=np.float64)
    out = np.zeros((*angle.shape, 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(angle)
    out[..., 1, 0] = np.sin(angle)
    out[..., 0, 1] = -out[..., 1, 0]
    out[..., 2, 2] = 1.0
    return out


def quaternion_about_z(yaw: ArrayLike) -> Array:
    """(..., 4) quaternions of turns by yaws (...) about z."""
    half = np.asarray(yaw, dtype=np.float64) / 2
    return np.stack([np.cos(half), np.zeros_like(half), np.zeros_like(half), np.sin(half)], axis=-1)


def yaw_of(rotation: Array) -> Array:
    """(...) yaw of matrices (..., 3, 3), or of poses (..., 4, 4) [rad]."""
    yaw: Array = np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0])
    return yaw


@kernel
def _place(points: Array, roll: float, pitch: float, yaw: float, origin: Array, out: Array) -> None:
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    for n in range(len(points)):
        x, y, z = points[n]
        forward, left = cp * x + sp * (sr * y + cr * z), cr * y - sr * z
        out[n, 0] = origin[0] + cy * forward - sy * left
        out[n, 1] = origin[1] + sy * forward + cy * left
        out[n, 2] = origin[2] + (-sp * x + cp * (sr * y + cr * z))


def place(points: ArrayLike, roll: float, pitch: float, yaw: float, origin: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """(..., 3) points in the world, of points (..., 3) in a base at ``origin`` (3,), turned by roll, pitch and yaw."""
    p = np.array(points, dtype=np.float64, order="C")
    out = np.empty_like(p)
    at = np.array(origin, dtype=np.float64)
    _place(p.reshape(-1, 3), float(roll), float(pitch), float(yaw), at, out.reshape(-1, 3))
    return out


def to_world(quaternion: Array, vectors: Array) -> Array:
    """Base vectors (n, 3) or (n, k, 3) in the world, for quaternions (n, 4)."""
    return _rotate(quaternion[:, :1], quaternion[:, 1:], vectors)


def to_base(quaternion: Array, vectors: Array) -> Array:
    """World vectors (n, 3) or (n, k, 3) in the base's frame, for quaternions (n, 4)."""
    return _rotate(quaternion[:, :1], -quaternion[:, 1:], vectors)


def _rotate(w: Array, axis: Array, vectors: Array) -> Array:
    if vectors.ndim == 3:
        w, axis = w[:, None], np.broadcast_to(axis[:, None], vectors.shape)
    twice = 2.0 * np.cross(axis, vectors)
    rotated: Array = vectors + w * twice + np.cross(axis, twice)
    return rotated


def multiply(a: Array, b: Array) -> Array:
    """Product of quaternions (..., 4): first b's turn, then a's."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )
