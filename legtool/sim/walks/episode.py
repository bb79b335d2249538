"""One simulated episode: a robot, a controller, commands, pushes and noise become a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ, Noise
from legtool.datasets.logs.recording import Recording
from legtool.sim.controllers.controller import Controller
from legtool.sim.robots.robot import SimRobot
from legtool.sim.walks.environment import Answer, Observation, VelocityCommand
from legtool.sim.walks.loop import run
from legtool.sim.walks.recorder import Recorder
from legtool.sim.walks.schedule import Schedule
from legtool.sim.walks.simulated import TIMEOUT, SimulatedRobot, Until
from legtool.sim.walks.walk_quality import Share, WalkQuality

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
        measured: how it walked, by :class:`.WalkQuality`.
        warnings: how often MuJoCo warned, by kind; of a bad position, velocity or acceleration the physics diverged.
    """

    recording: Recording
    joint_positions: Array
    joint_velocities: Array
    joint_torques: Array
    fell: bool
    duration_s: float
    measured: dict[str, Share]
    warnings: dict[str, int]


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
    environment = SimulatedRobot(
        None, robot, controller, rng=rng or np.random.default_rng(0), noise=noise, start=(0.0, 0.0, yaw),
        until=Until(schedule.duration_s, check_every=CONTROL_RATE_HZ // record_rate_hz),
    )  # fmt: skip
    recorder = Recorder(environment, ticks=environment.ticks, every=CONTROL_RATE_HZ // record_rate_hz)
    pusher = _Pusher(environment, pushes or Pushes.none())
    quality = WalkQuality(environment, pusher.times_s)
    outcome = run(environment, _Scheduled(controller, schedule), [recorder, pusher, quality])
    log = recorder.log
    return Episode(
        recording=log.recording(robot, name),
        joint_positions=log.joint_positions,
        joint_velocities=log.joint_velocities,
        joint_torques=log.joint_torques,
        fell=outcome != TIMEOUT,
        duration_s=environment.time_s,
        measured=quality.measured(),
        warnings=environment.simulation.warnings(),
    )


class _Scheduled:
    """Sends the commands of a schedule, each when the controller takes it up at a plain instant."""

    def __init__(self, controller: Controller, schedule: Schedule) -> None:
        self._controller, self._commands = controller, schedule.commands
        self._ticks = np.ceil(schedule.times_s * CONTROL_RATE_HZ).astype(int).tolist()
        self._answer = VelocityCommand(np.zeros(3))
        self._tick = self._next = 0

    def act(self, observation: Observation) -> VelocityCommand:
        """The command in force."""
        del observation
        due = self._next < len(self._ticks) and self._tick >= self._ticks[self._next]
        if due and self._controller.accepts_command():
            self._answer = VelocityCommand(self._commands[self._next])
            self._next += 1
        self._tick += 1
        return self._answer


class _Pusher:
    """Pushes the robot when it is time."""

    def __init__(self, environment: SimulatedRobot, pushes: Pushes) -> None:
        self._simulation, self._changes, self.times_s = environment.simulation, pushes.changes, pushes.times_s
        self._ticks = np.ceil(pushes.times_s * CONTROL_RATE_HZ).astype(int).tolist()
        self._next = 0

    def begin(self) -> None:
        """Push at the very start, if told to."""
        self._push()

    def tick(self, observation: Observation, answer: Answer) -> None:
        """Push before the next tick, if told to: one push at most."""
        del observation, answer
        self._push()

    def end(self) -> None:
        """Nothing to close."""

    def _push(self) -> None:
        if self._next < len(self._ticks) and self._simulation.tick >= self._ticks[self._next]:
            self._simulation.push(self._changes[self._next])
            self._next += 1
