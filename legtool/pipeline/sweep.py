"""Simulated sweeps: episodes in which a robot is walked through all changes of its velocity command."""

from __future__ import annotations

import numpy as np

from legtool.configs.robots import load_robot
from legtool.configs.sweep import SweepSettings
from legtool.sim.episode import Episode, Pushes, run_episode
from legtool.sim.robot import build_robot
from legtool.sim.schedule import sweep_schedule
from legtool.sim.trot import TrotController


def simulate_episode(settings: SweepSettings, index: int) -> Episode:
    """Simulate episode ``index`` of a sweep: the same bits for the same settings and index, in any process.

    Raises:
        RobotError: no such robot.
    """
    robot = build_robot(load_robot(settings.robot))
    rng = np.random.default_rng([settings.seed, index, 0])
    yaw = float(rng.uniform(-np.pi, np.pi))
    pushes = Pushes.random(rng, settings.episode_s, settings.push_rate_hz, settings.push_speed)
    return run_episode(
        robot,
        TrotController(robot, settings.controller),
        sweep_schedule(settings, index),
        pushes=pushes,
        noise=settings.noise,
        rng=rng,
        record_rate_hz=settings.record_rate_hz,
        name=f"{settings.robot}-{index:05d}",
        yaw=yaw,
    )
