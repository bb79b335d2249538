"""Collect transitions from a real robot's logs: one part per log, each read in bounded memory."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from legtool.configs.log import LogSettings
from legtool.configs.robots import load_robot
from legtool.configs.topics import load_topics
from legtool.datasets.contents import files_content
from legtool.datasets.logs.log import read_log
from legtool.datasets.motion.transitions import check_enough, cut_transitions
from legtool.datasets.provenance import commit
from legtool.datasets.store import Store, part_path, write_part
from legtool.errors import LogError
from legtool.pipeline.parts import run_parts


def collect_log(paths: Sequence[Path], settings: LogSettings, out: Path, *, workers: int = 1) -> dict[str, Any]:
    """Cut logs into a dataset of transitions.

    Args:
        paths: ``.bag``, ROS 2 bag directory, ``.db3``, ``.mcap``, ``.csv`` or a directory of CSVs, in time order.
        settings: robot, topics, and how steps are cut.
        out: the dataset's directory.
        workers: processes; the dataset does not depend on it.

    Returns:
        the dataset's manifest.

    Raises:
        LogError: a log is missing, damaged, implausible, or lacks a signal.
        OutputError: ``out`` holds something else, or cannot be written.
    """
    if not paths:
        raise LogError("no log was given; name one or more .bag, .db3, .mcap, .csv files or bag directories")
    robot = load_robot(settings.robot).geometry()
    topics = load_topics(settings.topics)
    inputs = [entry for path in paths for entry in _identify(path)]
    if settings.msgs is not None and settings.msgs.exists():
        inputs += files_content(settings.msgs)
    header = {
        "kind": "motion",
        "robot": robot.to_dict(),
        "settings": {**settings.to_dict(), "topics": topics.to_dict()},
        "inputs": inputs,
        "instant": "touchdown" if topics.events else settings.transitions.instant,
        "commit": commit(),
    }
    with Store(out, header) as store:
        write = functools.partial(write_log_part, store.path, list(paths), settings)
        manifest = run_parts(store, write, total=len(paths), workers=workers, description="reading logs", unit="logs")
    check_enough(manifest["counts"])
    return manifest


def write_log_part(root: Path, paths: Sequence[Path], settings: LogSettings, index: int) -> None:
    """Cut log ``index`` of ``paths`` and write its part of the dataset below ``root``."""
    path = paths[index]
    robot = load_robot(settings.robot).geometry()
    chunks = read_log(path, load_topics(settings.topics), robot, messages=settings.msgs)
    table, counts = cut_transitions(chunks, settings.transitions, episode=index)
    write_part(part_path(root, index), table, counts={"logs": 1, **counts})


def _identify(path: Path) -> list[dict[str, Any]]:
    """Name and hash of each file of a log, so that a dataset knows what it was made from."""
    if not path.exists():
        raise LogError(f"{path}: no such log")
    return files_content(path)
