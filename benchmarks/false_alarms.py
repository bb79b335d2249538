"""Whether sound logs are taken without a word: sweeps of several robots, recorded as ROS 1, ROS 2, MCAP and CSV.

    python benchmarks/false_alarms.py [LOG:TOPICS:ROBOT ...] [--robots aliengo,go2,hyq,anymal_c] [--sweeps 20]

Each sweep is collected in simulation with another seed, its recordings are written in the four kinds of logs, and each
of these is cut by ``collect log``. Counted are refusals, warnings, and numbers of steps that differ between the kinds.
Logs of your own that are known to be sound may be named beside.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from rosbags.convert.converter import convert

from legtool.configs.log import LogSettings
from legtool.configs.robots import load_geometry
from legtool.configs.sweep import SweepSettings
from legtool.configs.topics import load_topics
from legtool.datasets.logs.log import read_log
from legtool.datasets.store import load_dataset
from legtool.errors import LegtoolError
from legtool.evaluation.report.intervals import share
from legtool.pipeline.log import collect_log
from legtool.pipeline.sweep import RECORDINGS, collect_sweep

KINDS = ("mcap", "ros1", "ros2", "csv")
#: Signals of the CSV files: what a recording calls them, and how many columns each has.
SIGNALS = {
    "position": ("position_world", 3), "orientation": ("orientation", 4), "velocity": ("velocity_base", 3),
    "yaw_rate": ("yaw_rate", 1), "command": ("command", 3), "feet": ("feet_base", 12), "contact": ("contact_force", 4),
}  # fmt: skip


def rewrite(recording: Path, kind: str, folder: Path, robot: str) -> Path:
    """A recording of a sweep as another kind of log."""
    if kind == "mcap":
        return recording
    if kind == "csv":
        path = folder / f"{recording.stem}.csv"
        parts = list(read_log(recording, load_topics("legtool"), load_geometry(robot).geometry()))
        stamps = np.concatenate([part.stamps_ns for part in parts])
        columns = {"time": [f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in stamps]}
        for name, (attribute, count) in SIGNALS.items():
            values = np.concatenate([np.asarray(getattr(part, attribute)).reshape(len(part), -1) for part in parts])
            columns |= {f"{name}_{k}": values[:, k] for k in range(count)}
        pd.DataFrame(columns).to_csv(path, index=False)
        return path
    path = folder / (f"{recording.stem}.bag" if kind == "ros1" else recording.stem)
    plain = {"compress": None, "compress_mode": "file", "default_typestore": None, "typestore": None}
    nothing = dict.fromkeys(("exclude_topics", "include_topics", "exclude_msgtypes", "include_msgtypes"), ())
    convert([recording], path, dst_storage="sqlite3", dst_version=9, **plain, **nothing)
    return path


def csv_topics(folder: Path) -> str:
    """Where such CSV files hold their signals."""
    topics: dict[str, object] = {"name": "columns", "csv": {"files": {"*.csv": None}, "header": True, "stamp": "time"}}
    for name, (_, count) in SIGNALS.items():
        topics[name] = {"columns": [f"{name}_{k}" for k in range(count)]}
    topics["orientation"] = {**topics["orientation"], "order": "wxyz"}  # type: ignore[dict-item]
    path = folder / "topics.yaml"
    path.write_text(yaml.safe_dump(topics))
    return str(path)


def cut(logs: list[Path], topics: str, robot: str, out: Path) -> tuple[float, list[str]]:
    """Number of steps, and all that was said."""
    try:
        manifest = collect_log(logs, LogSettings(robot=robot, topics=topics), out, workers=1)
    except LegtoolError as error:
        return 0.0, [f"refused: {error}"]
    return manifest["counts"]["steps"], list(manifest.get("notes", ()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="*", metavar="LOG:TOPICS:ROBOT")
    parser.add_argument("--robots", default="aliengo,go2,hyq,anymal_c")
    parser.add_argument("--sweeps", type=int, default=20)
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    robots, told = options.robots.split(","), Counter[str]()
    for number in range(options.sweeps):
        robot = robots[number % len(robots)]
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            collect_sweep(
                SweepSettings(robot=robot, episodes=options.episodes, seed=options.seed + number), folder / "sweep"
            )
            recordings = sorted((folder / "sweep" / RECORDINGS).glob("*.mcap"))
            own = load_dataset(folder / "sweep").manifest["counts"]["steps"]
            for kind in KINDS:
                logs = [rewrite(recording, kind, folder, robot) for recording in recordings]
                topics = csv_topics(folder) if kind == "csv" else "legtool"
                steps, notes = cut(logs, topics, robot, folder / f"{kind}_data")
                told["logs"] += 1
                told["refused"] += any(note.startswith("refused") for note in notes)
                told["warned"] += bool(notes) and not any(note.startswith("refused") for note in notes)
                told["other steps"] += steps != own
                print(
                    f"{robot} {options.seed + number} {kind}: {steps:g} steps of {own:g}",
                    *notes,
                    sep="\n  ",
                    flush=True,
                )
    for given in options.logs:
        path, topics, robot = given.split(":")
        with tempfile.TemporaryDirectory() as place:
            steps, notes = cut([Path(path)], topics, robot, Path(place) / "data")
        told["logs"] += 1
        told["refused"] += any(note.startswith("refused") for note in notes)
        told["warned"] += bool(notes) and not any(note.startswith("refused") for note in notes)
        print(f"{given}: {steps:g} steps", *notes, sep="\n  ", flush=True)
    for what in ("refused", "warned", "other steps"):
        low, high = share(told[what], told["logs"])["ci95"] or (0.0, 1.0)
        print(f"{what}: {told[what]} of {told['logs']} [{100 * low:.1f}, {100 * high:.1f}] %")


if __name__ == "__main__":
    main()
