"""Measurement: what the robot believes of its state, and how far that is from the truth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from legtool.configs.sweep import Noise
from legtool.sim.robots.state import FORCES, JOINT_VELOCITIES, JOINTS, ORIENTATION, RATE, VELOCITY
from legtool_runtime.cache import kernel

Array = NDArray[np.float64]

#: Columns of an error row: position, rotation vector, velocity, angular velocity, joints, joint velocities, forces.
ERROR_SIZE = 40


def sense_errors(noise: Noise, rng: np.random.Generator, ticks: int, *, rate_hz: float, weight: float) -> Array:
    """(ticks, 40) errors to add at each tick. ``weight`` of the robot [N] scales the foot forces' error."""
    errors = rng.standard_normal((ticks, ERROR_SIZE))
    keep = np.exp(-1.0 / (noise.correlation_s * rate_hz))
    # First-order wandering with unit variance from the first tick on.
    wander = errors[:, :9] * np.sqrt(1.0 - keep**2)
    wander[0] = errors[0, :9]
    errors[:, :9] = lfilter([1.0], [1.0, -keep], wander, axis=0)
    scale = np.empty(ERROR_SIZE)
    scale[0:3] = noise.position
    scale[3:6] = noise.attitude
    scale[6:9] = noise.velocity
    scale[9:12] = noise.angular_velocity
    scale[12:24] = noise.joint_position
    scale[24:36] = noise.joint_velocity
    scale[36:40] = noise.foot_force * weight
    return errors * scale


class SimulatorLayout(NamedTuple):
    """Where the simulator's arrays hold what is measured.

    Attributes:
        base_qpos: index of the base's position and quaternion in ``qpos``.
        base_dof: index of its velocities in ``qvel``.
        qpos: (4, 3) indices of the joint angles.
        dof: (4, 3) indices of the joint velocities.
        sign: (4, 3) ±1, by which a joint of the simulator turns the other way round.
        offset: (4, 3) that is added to it [rad].
        force_sensor: (4,) indices of the feet's touch sensors.
    """

    base_qpos: int
    base_dof: int
    qpos: NDArray[np.int64]
    dof: NDArray[np.int64]
    sign: Array
    offset: Array
    force_sensor: NDArray[np.int64]


@kernel
def measure(qpos: Array, qvel: Array, sensors: Array, layout: SimulatorLayout, error: Array, values: Array) -> None:
    """Write the measured state from the simulator's arrays and an error row.

    Args:
        qpos: MuJoCo's positions.
        qvel: its velocities.
        sensors: its sensor data.
        layout: where each holds what.
        error: (ERROR_SIZE,) a row of :func:`sense_errors`.
        values: (STATE_SIZE,) is overwritten, see ``RobotState``.
    """
    base_qpos, base_dof, joint_qpos, joint_dof, sign, offset, force_sensor = layout
    for i in range(3):
        values[i] = qpos[base_qpos + i] + error[i]
        values[VELOCITY + i] = qvel[base_dof + i] + error[6 + i]
        values[RATE + i] = qvel[base_dof + 3 + i] + error[9 + i]
    w, x, y, z = qpos[base_qpos + 3], qpos[base_qpos + 4], qpos[base_qpos + 5], qpos[base_qpos + 6]
    a, b, c = 0.5 * error[3], 0.5 * error[4], 0.5 * error[5]
    # Quaternion times a small rotation in the base frame.
    tw = w - a * x - b * y - c * z
    tx = x + a * w + c * y - b * z
    ty = y + b * w + a * z - c * x
    tz = z + c * w + b * x - a * y
    norm = np.sqrt(tw * tw + tx * tx + ty * ty + tz * tz)
    values[ORIENTATION], values[ORIENTATION + 1] = tw / norm, tx / norm
    values[ORIENTATION + 2], values[ORIENTATION + 3] = ty / norm, tz / norm
    for leg in range(4):
        for joint in range(3):
            k = 3 * leg + joint
            values[JOINTS + k] = sign[leg, joint] * qpos[joint_qpos[leg, joint]] + offset[leg, joint] + error[12 + k]
            values[JOINT_VELOCITIES + k] = sign[leg, joint] * qvel[joint_dof[leg, joint]] + error[24 + k]
        values[FORCES + leg] = max(0.0, sensors[force_sensor[leg]] + error[36 + leg])
