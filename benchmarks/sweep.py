"""How well the built-in trotting controller walks, and how fast it is simulated.

Run ``python benchmarks/sweep.py``; ``--robot`` for one robot alone, ``--quick`` for a tenth of each campaign.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from legtool.configs.robots import load_robot
from legtool.configs.sweep import Noise, SweepSettings
from legtool.pipeline.sweep import simulate_episode
from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool.sim.walks.episode import Episode, Pushes, run_episode
from legtool.sim.walks.schedule import Schedule, random_schedule

VX_GRID = (-0.3, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
EPISODE_S = 60.0


def run(robot: SimRobot, schedule: Schedule, seed: int, pushes: Pushes | None = None) -> Episode:
    return run_episode(
        robot,
        TrotController(robot),
        schedule,
        pushes=pushes,
        noise=Noise(),
        rng=np.random.default_rng(seed),
    )


def random_walk_falls(robot: SimRobot, minutes: float) -> int:
    """Random 3-D commands with sensor noise, a minute at a time."""
    return sum(run(robot, random_schedule(EPISODE_S, seed), seed).fell for seed in range(round(minutes)))


def standing_start_falls(robot: SimRobot, count: int) -> int:
    """From standing to a random command at once, three seconds of walking, and to a stop at once."""
    low, high = np.array([-0.3, -0.3, -0.6]), np.array([1.0, 0.3, 0.6])
    falls = 0
    for seed in range(count):
        command = np.random.default_rng([seed, 7]).uniform(low, high)
        # The last ones are the corners of the box, where starts are hardest.
        if seed >= count - 8:
            command = np.where([(seed >> bit) & 1 for bit in range(3)], low, high)
        schedule = Schedule(np.array([0.0, 1.0, 4.0]), np.array([np.zeros(3), command, np.zeros(3)]), 7.0)
        falls += run(robot, schedule, seed).fell
    return falls


def push_falls(robot: SimRobot, count: int, speed: float) -> int:
    """Pushes of one size from all sides, one every six seconds, at random commands; every fifth while standing."""
    falls = 0
    for seed in range(count):
        rng = np.random.default_rng([seed, 8])
        command = np.zeros(3) if seed % 5 == 0 else rng.uniform([-0.3, -0.3, -0.6], [1.0, 0.3, 0.6])
        angle = 2 * np.pi * seed / count
        change = speed * np.array([[np.cos(angle), np.sin(angle)]])
        schedule = Schedule(np.array([0.0, 0.5]), np.array([np.zeros(3), command]), 7.0)
        falls += run(robot, schedule, seed, Pushes(np.array([3.0 + rng.uniform(0, 0.7)]), change)).fell
    return falls


def tracking_error(robot: SimRobot) -> list[tuple[float, float]]:
    """(commanded, reached) vx over the grid: mean over eight steady seconds of walking straight on."""
    out = []
    for seed, vx in enumerate(VX_GRID):
        schedule = Schedule(np.array([0.0, 0.5]), np.array([[0.0, 0, 0], [vx, 0, 0]]), 12.0)
        recording = run(robot, schedule, seed).recording
        steady = recording.stamps_ns > 4_000_000_000
        out.append((vx, float(recording.velocity_base[steady, 0].mean())))
    return out


def real_time_factor(name: str, rate_hz: int, episodes: int) -> float:
    """Simulated over processor time of whole sweep episodes, building the robot and recording included."""
    settings = SweepSettings(robot=name, record_rate_hz=rate_hz)
    simulate_episode(settings, 0)  # compiles
    start, simulated = time.process_time(), 0.0
    for index in range(episodes):
        simulated += simulate_episode(settings, index).duration_s
    return simulated / (time.process_time() - start)


def report(name: str, minutes: float, starts: int, pushes: int) -> None:
    robot = build_robot(load_robot(name))
    print(f"{name}: {robot.mass:.1f} kg", flush=True)
    reached = tracking_error(robot)
    print("  vx commanded → reached: " + ", ".join(f"{a:.1f} → {b:.3f}" for a, b in reached))
    print(f"  mean |vx error| over the grid: {np.mean([abs(a - b) for a, b in reached]):.4f} m/s", flush=True)
    print(f"  falls in {starts} standing starts and stops: {standing_start_falls(robot, starts)}", flush=True)
    print(f"  falls in {pushes} pushes of 0.5 m/s: {push_falls(robot, pushes, 0.5)}", flush=True)
    print(f"  falls in {minutes:.0f} min of random 3-D commands: {random_walk_falls(robot, minutes)}", flush=True)
    for rate_hz in (100, 200):
        factor = real_time_factor(name, rate_hz, 6)
        print(f"  real-time factor on one core, recording at {rate_hz} Hz: {factor:.1f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", choices=("aliengo", "go2", "hyq"))
    parser.add_argument("--quick", action="store_true", help="a tenth of each campaign")
    options = parser.parse_args()
    share = 0.1 if options.quick else 1.0
    for name in (options.robot,) if options.robot else ("aliengo", "go2", "hyq"):
        minutes = 30 if name == "aliengo" else 10
        report(name, share * minutes, round(share * 60), round(share * 60))


if __name__ == "__main__":
    main()
