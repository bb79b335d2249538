"""One simulated episode: a robot, a controller, commands, pushes and noise become a recording."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ, Noise
from legtool.datasets.recording import Recording
from legtool.sim.controller import FORCES, JOINT_VELOCITIES, JOINTS, ORIENTATION, RATE, STATE_SIZE, VELOCITY
from legtool.sim.controller import Controller, RobotState
from legtool.sim.noise import ERROR_SIZE, measure, sense_errors
from legtool.sim.gait import GRAVITY
from legtool.sim.robot import SimRobot
from legtool.sim.schedule import Schedule
from legtool.sim.world import SUBSTEPS

Array = NDArray[np.float64]

#: A robot has fallen when it leans more than this [rad], or its trunk is lower above its feet than this share of standing.
FALL_TILT = 0.9
FALL_HEIGHT = 0.45
TICK_NS = 1_000_000_000 // CONTROL_RATE_HZ


@dataclass(frozen=True, eq=False)
class Pushes:
    """Instant changes of the base's horizontal velocity: (n,) times [s], increasing, and (n, 2) changes, world frame [m/s]."""

    times_s: Array
    changes: Array

    @classmethod
    def none(cls) -> Pushes:
        """No push."""
        return cls(np.empty(0), np.empty((0, 2)))

    @classmethod
    def random(cls, rng: np.random.Generator, duration_s: float, rate_hz: float, speed: float) -> Pushes:
        """Pushes at random times, in random directions, of sizes up to ``speed`` [m/s]."""
        times = np.sort(rng.uniform(0.0, duration_s, size=rng.poisson(rate_hz * duration_s)))
        angle = rng.uniform(-np.pi, np.pi, size=len(times))
        size = rng.uniform(0.0, speed, size=len(times))
        return cls(times, np.stack([size * np.cos(angle), size * np.sin(angle)], axis=1))


@dataclass(frozen=True, eq=False)
class Episode:
    """What one episode left behind.

    Attributes:
        recording: the robot as it measured itself.
        joint_positions: (n, 4, 3) at the recording's rows [rad]; ``joint_velocities`` (n, 4, 3) [rad/s].
        joint_torques: (n, 4, 3) commanded at those rows [Nm].
        fell: whether the robot fell; the episode ends there, after ``duration_s``.
        duration_s: simulated time.
    """

    recording: Recording
    joint_positions: Array
    joint_velocities: Array
    joint_torques: Array
    fell: bool
    duration_s: float


def run_episode(
    robot: SimRobot,
    controller: Controller,
    schedule: Schedule,
    *,
    pushes: Pushes | None = None,
    noise: Noise | None = None,
    rng: np.random.Generator | None = None,
    record_rate_hz: int = 200,
    name: str = "episode",
    yaw: float = 0.0,
) -> Episode:
    """Simulate a schedule from a standing start at the origin.

    Stamps start at 0. A command is sent at its scheduled time or, where the controller asks for it, at the next instant
    from which on it is plain when the robot takes it up (``Controller.accepts_command``).
    """
    pushes = pushes or Pushes.none()
    data = mujoco.MjData(robot.model)
    robot.place(data, yaw=yaw)
    ticks = int(round(schedule.duration_s * CONTROL_RATE_HZ))
    every = CONTROL_RATE_HZ // record_rate_hz
    if noise is None:
        errors = np.zeros((1, ERROR_SIZE))
    else:
        generator = rng if rng is not None else np.random.default_rng(0)
        errors = sense_errors(noise, generator, ticks, rate_hz=CONTROL_RATE_HZ, weight=robot.mass * GRAVITY)
    state = RobotState()
    values = state.values
    qpos, qvel, sensors, applied = data.qpos, data.qvel, data.sensordata, data.qfrc_applied
    dof = robot.dof.ravel()
    sign = robot.joint_sign.ravel()
    where = (
        robot.base_qpos,
        robot.base_dof,
        robot.qpos,
        robot.dof,
        robot.joint_sign,
        robot.joint_offset,
        robot.force_sensor,
    )
    change_ticks = np.ceil(schedule.times_s * CONTROL_RATE_HZ).astype(int).tolist()
    push_ticks = np.ceil(pushes.times_s * CONTROL_RATE_HZ).astype(int).tolist()
    change_ticks.append(ticks + 1)
    push_ticks.append(ticks + 1)
    log = np.empty((ticks // every + 1, STATE_SIZE))
    commands = np.empty((len(log), 3))
    torques = np.empty((len(log), 12))
    command = np.zeros(3)
    rows = change = push = 0
    fell = False
    tick = 0
    lowest = FALL_HEIGHT * robot.geometry.standing_height
    upright = np.cos(FALL_TILT)

    measure(qpos, qvel, sensors, *where, errors[0], values)
    controller.reset(state)
    for tick in range(ticks):
        if tick >= push_ticks[push]:
            qvel[robot.base_dof : robot.base_dof + 2] += pushes.changes[push]
            push += 1
        measure(qpos, qvel, sensors, *where, errors[tick if noise is not None else 0], values)
        if tick >= change_ticks[change] and controller.accepts_command():
            command = schedule.commands[change]
            change += 1
        torque = controller.step(state, command)
        if tick % every == 0:
            log[rows] = values
            commands[rows] = command
            torques[rows] = torque
            rows += 1
            if _down(robot, values, lowest, upright):
                fell = True
                break
        applied[dof] = torque * sign
        mujoco.mj_step(robot.model, data, SUBSTEPS)
    log, commands, torques = log[:rows], commands[:rows], torques[:rows]
    return Episode(
        recording=_recording(robot, log, commands, every * TICK_NS, name),
        joint_positions=log[:, JOINTS:JOINT_VELOCITIES].reshape(-1, 4, 3).copy(),
        joint_velocities=log[:, JOINT_VELOCITIES:FORCES].reshape(-1, 4, 3).copy(),
        joint_torques=torques.reshape(-1, 4, 3),
        fell=fell,
        duration_s=(tick + 1) / CONTROL_RATE_HZ,
    )


def _down(robot: SimRobot, values: Array, lowest: float, upright: float) -> bool:
    """Whether the robot lies: leaning, low above its lowest foot, or gone from where numbers are finite."""
    w, x, y, z = values[ORIENTATION:VELOCITY]
    up = 1.0 - 2.0 * (x * x + y * y)
    if not up > upright:
        return True
    feet = robot.geometry.feet(values[JOINTS:JOINT_VELOCITIES])
    below = 2.0 * (x * z - w * y) * feet[:, 0] + 2.0 * (y * z + w * x) * feet[:, 1] + up * feet[:, 2]
    return bool(-below.min() < lowest)


def _recording(robot: SimRobot, log: Array, commands: Array, step_ns: int, name: str) -> Recording:
    orientation = log[:, ORIENTATION:VELOCITY]
    return Recording(
        name=name,
        stamps_ns=np.arange(len(log), dtype=np.int64) * step_ns,
        position_world=log[:, :ORIENTATION].copy(),
        orientation=orientation.copy(),
        velocity_base=_to_base(orientation, log[:, VELOCITY:RATE]),
        yaw_rate=log[:, RATE + 2].copy(),
        command=commands,
        feet_base=robot.geometry.feet(log[:, JOINTS:JOINT_VELOCITIES]),
        contact_force=log[:, FORCES:].copy(),
    )


def _to_base(orientation: Array, vectors: Array) -> Array:
    """(n, 3) world vectors in the base frame."""
    w, axis = orientation[:, :1], -orientation[:, 1:]
    twice = 2.0 * np.cross(axis, vectors)
    return vectors + w * twice + np.cross(axis, twice)
