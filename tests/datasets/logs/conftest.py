"""A trot with known truth, whose signals tests change before they write it as a log of some kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from legtool.configs.log import LogSettings
from legtool.configs.robots import load_geometry, load_robot
from legtool.datasets.store import load_dataset
from legtool.errors import LegtoolError
from legtool.pipeline.log import collect_log
from legtool_runtime.robot import TROT_PAIRS, Robot
from legtool_runtime.rotations import about_z

RATE, STEP_S, STANCE_S = 200, 0.3, 0.06
#: Columns of a wide CSV file of a walk.
COLUMNS = {
    "position": [1, 2, 3],
    "orientation": [4, 5, 6, 7],
    "velocity": [8, 9, 10],
    "yaw_rate": [11],
    "command": [12, 13, 14],
    "feet": list(range(15, 27)),
    "contact": list(range(27, 31)),
    "joints": list(range(31, 43)),
}
HEADER = [
    "time", "px", "py", "pz", "qx", "qy", "qz", "qw", "vx", "vy", "vz", "wz", "cmd_vx", "cmd_vy", "cmd_wz",
    *(f"{leg}_{axis}" for leg in ("FL", "FR", "RL", "RR") for axis in "xyz"),
    *(f"f_{leg}" for leg in ("FL", "FR", "RL", "RR")),
    *(f"{leg}_{joint}" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "knee")),
]  # fmt: skip

Signals = dict[str, np.ndarray]


def trot(robot: Robot, seconds: float, *, seed: int = 0, heading: float = 1.0) -> Signals:
    """A trot over flat ground at a command that changes every second and a half, forwards, sideways and in turns.

    Returns:
        ``stamps`` (n,) [ns] and the signals of ``COLUMNS`` (n, k); the trunk follows the command after 0.15 s.
    """
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE)
    t = np.arange(n) / RATE
    told = rng.uniform([0.2, -0.15, -0.5], [0.5, 0.15, 0.7], size=(int(seconds / 1.5) + 2, 3))
    command = told[(t / 1.5).astype(int)]
    velocity = told[(np.maximum(t - 0.15, 0) / 1.5).astype(int)].copy()
    yaw = np.cumsum(velocity[:, 2]) / RATE + heading
    rotation = about_z(yaw)
    moved = np.einsum("nij,nj->ni", rotation[:, :2, :2], velocity[:, :2]) / RATE
    position = np.column_stack([np.cumsum(moved, axis=0), np.full(n, -robot.stance[:, 2].mean() + robot.foot_radius)])
    world = np.empty((n, 4, 3))
    forces = np.full((n, 4), 80.0)
    held = position[0] + robot.stance @ rotation[0].T
    period = int(STEP_S * RATE)
    for step, begin in enumerate(range(0, n, period)):
        end = min(begin + period, n)
        world[begin:end] = held
        ahead = min(begin + period + period // 2, n - 1)
        lift = begin + int(STANCE_S * RATE)
        if lift >= end:
            break
        share = (np.arange(lift, end) - lift) / (period - int(STANCE_S * RATE))
        for leg in TROT_PAIRS[step % 2]:
            target = position[ahead] + rotation[ahead] @ robot.stance[leg]
            world[lift:end, leg] = held[leg] + (3 * share**2 - 2 * share**3)[:, None] * (target - held[leg])
            world[lift:end, leg, 2] += 0.06 * np.sin(np.pi * share)
            forces[lift:end, leg] = 0.0
            held[leg] = target
    feet = np.einsum("nji,nkj->nki", rotation, world - position[:, None])
    joints, _ = robot.joints(feet)
    zero = np.zeros(n)
    return {
        "stamps": 1_700_000_000_250_000_000 + (t * 1e9).round().astype(np.int64),
        "position": position,
        "orientation": np.column_stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)]),
        "velocity": np.column_stack([velocity[:, :2], zero]),
        "yaw_rate": velocity[:, 2:],
        "command": command,
        "feet": feet.reshape(n, 12),
        "contact": forces,
        "joints": joints.reshape(n, 12),
    }


@pytest.fixture(scope="session")
def go2() -> Robot:
    return load_robot("go2").geometry()


@pytest.fixture(scope="session")
def _trot(go2: Robot) -> Signals:
    return trot(go2, 12.0)


@pytest.fixture(scope="session")
def make_walk(go2: Robot) -> Callable[..., Signals]:
    """Other walks than :func:`walk`: by robot, seed, heading at the start [rad], and length [s]."""

    def make(*, seconds: float = 12.0, robot: str | None = None, **options: Any) -> Signals:
        return trot(go2 if robot is None else load_geometry(robot).geometry(), seconds, **options)

    return make


@pytest.fixture
def walk(_trot: Signals) -> Signals:
    """Twelve seconds of Go2, 40 steps; a copy, to be changed."""
    return {name: values.copy() for name, values in _trot.items()}


@pytest.fixture
def collect(tmp_path: Path) -> Callable[..., dict[str, Any] | str]:
    """Collects transitions from logs; returns the manifest, or the text for which they were refused."""

    def run(*logs: Path, topics: Any = "ros2_standard", robot: str = "go2", **settings: Any) -> dict[str, Any] | str:
        if isinstance(topics, dict):
            (tmp_path / "topics.yaml").write_text(yaml.safe_dump(topics))
            topics = str(tmp_path / "topics.yaml")
        out = tmp_path / f"data-{len(list(tmp_path.glob('data-*')))}"
        try:
            manifest = collect_log(list(logs), LogSettings(robot=robot, topics=topics, **settings), out)
            return {**manifest, "path": out}
        except LegtoolError as error:
            assert "\n" not in str(error)
            assert not list(out.glob("*.parquet")) and not (out / "manifest.json").exists()
            return str(error)

    return run


@pytest.fixture(scope="session")
def steps_of() -> Callable[[dict[str, Any]], pd.DataFrame]:
    """The usable steps of what ``collect`` returned."""

    def read(manifest: dict[str, Any]) -> pd.DataFrame:
        table = load_dataset(manifest["path"]).table.to_pandas()
        return table[table["status"] == "ok"].reset_index(drop=True)

    return read


def wide(*signals: str, **changes: Any) -> dict[str, Any]:
    """Topics of the CSV file that ``write_csv`` writes; changes go into signals, or replace what is no signal."""
    signals = signals or ("position", "orientation", "velocity", "yaw_rate", "command", "feet", "contact")
    topics: dict[str, Any] = {"name": "wide", "csv": {"files": {"*.csv": 43}, "header": True}}
    topics |= {name: {"columns": COLUMNS[name]} for name in signals}
    for name, change in changes.items():
        topics[name] = {**topics[name], **change} if isinstance(topics.get(name), dict) else change
    return topics


@pytest.fixture(scope="session")
def topics_of() -> Callable[..., dict[str, Any]]:
    return wide


@pytest.fixture
def write_csv(tmp_path: Path) -> Callable[..., Path]:
    """Writes a walk as one wide CSV file with a header."""

    def write(walk: Signals, *, digits: int = 9, name: str = "walk.csv", scale: int = 10**9) -> Path:
        table = np.column_stack([walk[name] for name in COLUMNS])
        lines = [",".join(HEADER)]
        for stamp, row in zip(walk["stamps"].tolist(), table.tolist(), strict=True):
            lines.append(",".join([f"{stamp / scale:.{digits}f}", *(format(value, ".9g") for value in row)]))
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        return tmp_path / name

    return write


@pytest.fixture
def as_motion(motion: Any) -> Callable[[Signals], Any]:
    """A walk as the motion that ``write_log`` writes as a bag: odometry, command, joints, forces."""

    def convert(walk: Signals) -> Any:
        stamps, quaternion = walk["stamps"], walk["orientation"]
        pose = np.column_stack([walk["position"], quaternion[:, [3, 0, 1, 2]]])
        twist = np.column_stack([walk["velocity"], np.zeros((len(stamps), 2)), walk["yaw_rate"]])
        every = slice(None, None, 4)
        return type(motion)(
            (stamps, pose),
            (stamps, twist),
            (stamps[every], walk["command"][every]),
            (stamps, walk["joints"]),
            (stamps, walk["contact"]),
        )

    return convert
