"""Simulated sweeps: episodes in which a robot is walked through all changes of its velocity command."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from legtool.configs.robots import load_robot
from legtool.configs.sweep import SweepSettings
from legtool.datasets.contents import controller_content, robot_content
from legtool.datasets.logs.mcap_writer import write_mcap
from legtool.datasets.motion.transitions import check_enough, cut_transitions
from legtool.datasets.store import Store, part_path, write_part
from legtool.datasets.work import digest
from legtool.pipeline.parts import run_parts
from legtool.pipeline.sweep_verdict import judge_sweep
from legtool.provenance import commit
from legtool.sim.controllers.blackbox import make_controller
from legtool.sim.robots.masses import doubtful_masses
from legtool.sim.robots.mjcf import find_mjcf, load_mjcf
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool.sim.walks.episode import Episode, Pushes, run_episode
from legtool.sim.walks.schedule import sweep_schedule
from legtool.workers import Workers

RECORDINGS = "recordings"


def collect_sweep(settings: SweepSettings, out: Path, *, workers: int | Workers = 1) -> dict[str, Any]:
    """Simulate every episode of a sweep, record it as MCAP, and cut it into a dataset of transitions.

    Args:
        settings: robot, commands, disturbances, and how steps are cut.
        out: the dataset's directory; a sweep that was interrupted there carries on.
        workers: processes; the dataset does not depend on it.

    Returns:
        the dataset's manifest; ``counts`` tells the falls, ``verdict`` how the robot walked (:func:`.judge_sweep`).

    Raises:
        RobotError: no such robot, or an MJCF that it cannot be found in.
        OutputError: ``out`` holds something else, or cannot be written.
    """
    robot = sweep_robot(settings)
    geometry, doubts = robot.geometry, doubtful_masses(robot)
    mjcf = None if settings.mjcf is None else find_mjcf(settings.mjcf)
    contents = {
        "robot": robot_content(settings.robot, mjcf, settings.mjcf_names),
        "controller": controller_content(settings.black_box),
    }
    header = {
        "kind": "motion",
        "robot": geometry.to_dict(),
        "settings": settings.to_dict(),
        "seed": settings.seed,
        "inputs": [{"name": name, "sha256": digest(content)} for name, content in contents.items()],
        "instant": settings.transitions.instant,
        "commit": commit(),
        **({"held_joints": list(robot.held)} if robot.held else {}),
    }

    def judge(finished: Mapping[str, Any]) -> dict[str, Any]:
        return judge_sweep(finished, doubts).to_dict()

    with Store(out, header, shard=Workers.of(workers).name) as store:
        write = functools.partial(write_episode, store.path, settings)
        manifest = run_parts(
            store,
            write,
            total=settings.episodes,
            workers=workers,
            description="simulating",
            unit="episodes",
            judge=judge,
        )
    if manifest["verdict"]["level"] != "red":  # which says more of why there are few steps
        check_enough(manifest["counts"])
    return manifest


def write_episode(root: Path, settings: SweepSettings, index: int) -> None:
    """Simulate one episode and write its recording and its part of the dataset below ``root``."""
    episode = simulate_episode(settings, index)
    name = f"{RECORDINGS}/episode-{index:05d}.mcap"
    (root / RECORDINGS).mkdir(exist_ok=True)
    write_mcap(
        root / name,
        episode.recording,
        joint_positions=episode.joint_positions,
        joint_velocities=episode.joint_velocities,
        frames=True,
        metadata={"robot": settings.robot, "seed": str(settings.seed), "episode": str(index)},
    )
    table, counts = cut_transitions([episode.recording], settings.transitions, episode=index)
    warnings = {f"mujoco_{kind}": number for kind, number in episode.warnings.items()}
    counts = {"episodes": 1, "falls": int(episode.fell), **counts, **warnings}
    write_part(part_path(root, index), table, counts=counts, files=[name], measured=episode.measured)


def sweep_robot(settings: SweepSettings) -> SimRobot:
    """The robot on a flat floor: of primitives, or out of its own MJCF file.

    Raises:
        RobotError: no such robot, or an MJCF file that it cannot be found in.
    """
    if settings.mjcf is not None:
        return load_mjcf(find_mjcf(settings.mjcf), settings.mjcf_names)
    return build_robot(load_robot(settings.robot))


def simulate_episode(settings: SweepSettings, index: int) -> Episode:
    """Simulate episode ``index`` of a sweep: the same bits for the same settings and index, in any process.

    Raises:
        RobotError: no such robot, or an MJCF file that it cannot be found in.
    """
    robot = sweep_robot(settings)
    rng = np.random.default_rng([settings.seed, index, 0])
    yaw = float(rng.uniform(-np.pi, np.pi))
    pushes = Pushes.random(rng, settings.episode_s, settings.push_rate_hz, settings.push_speed)
    return run_episode(
        robot,
        make_controller(robot, settings.black_box, settings.controller),
        sweep_schedule(settings, index),
        pushes=pushes,
        noise=settings.noise,
        rng=rng,
        record_rate_hz=settings.record_rate_hz,
        name=f"{robot.geometry.name}-{index:05d}",
        yaw=yaw,
    )
