"""One simulated episode: a robot, a controller, commands, pushes and noise become a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ, Noise
from legtool.datasets.logs.recording import Recording
from legtool.sim.controllers.controller import Controller
from legtool.sim.robots.robot import SimRobot
from legtool.sim.walks.schedule import Schedule
from legtool.sim.walks.simulation import Log, Simulation

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pushes:
    """Instant changes of the base's horizontal velocity.

    Attributes:
        times_s: (n,) when, increasing [s].
        changes: (n, 2) world frame [m/s].
    """

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
    ticks = round(schedule.duration_s * CONTROL_RATE_HZ)
    simulation = Simulation(robot, controller, ticks=ticks, noise=noise, rng=rng, yaw=yaw)
    simulation.begin()
    log = Log(ticks=ticks, every=CONTROL_RATE_HZ // record_rate_hz)
    change_ticks = np.ceil(schedule.times_s * CONTROL_RATE_HZ).astype(int).tolist()
    push_ticks = np.ceil(pushes.times_s * CONTROL_RATE_HZ).astype(int).tolist()
    change_ticks.append(ticks + 1)
    push_ticks.append(ticks + 1)
    command = np.zeros(3)
    change = push = 0
    fell = False
    for tick in range(ticks):
        if tick >= push_ticks[push]:
            simulation.push(pushes.changes[push])
            push += 1
        simulation.observe()
        if tick >= change_ticks[change] and controller.accepts_command():
            command = schedule.commands[change]
            change += 1
        simulation.act(command)
        if tick % log.every == 0:
            log.add(simulation.state.values, command, simulation.torque)
            if simulation.fallen():
                fell = True
                break
    return Episode(
        recording=log.recording(robot, name),
        joint_positions=log.joint_positions,
        joint_velocities=log.joint_velocities,
        joint_torques=log.joint_torques,
        fell=fell,
        duration_s=simulation.time_s,
    )
