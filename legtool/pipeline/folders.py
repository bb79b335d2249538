"""Which logs a folder holds: one, whose files belong together, or several."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

from legtool.configs.topics import TopicSettings
from legtool.datasets.logs.bagfile import bag_files, natural, opened
from legtool.datasets.logs.formats import is_log, kind_of
from legtool.datasets.logs.tablefiles import tables_in
from legtool.errors import LogError

#: Files of one recording that was divided follow each other: by so much may one begin before the last one's end [s].
_SHARED_S = 1.0


def logs_in(path: Path, topics: TopicSettings) -> list[Path]:
    """The logs at a path.

    Args:
        path: a log, or a folder of logs.
        topics: where the signals of a log are.

    Returns:
        the path itself if it is one log: a file, a ROS 2 bag, bag files that follow each other, or tables of which each
        holds some of the signals. Else the logs in the folder, by name: bag files of the same time or of other days,
        tables that hold all signals each, or folders that are logs.

    Raises:
        LogError: there is nothing at the path, or no log.
    """
    if not path.exists():
        raise LogError(f"{path}: no such log")
    if not path.is_dir():
        return [path]
    if inner := inner_logs(path):
        return [log for folder in inner for log in logs_in(folder, topics)]
    kind = kind_of(path)
    if kind == "csv" and topics.csv is not None and len(topics.csv.files) == 1:
        pattern = next(iter(topics.csv.files))
        tables = [file for file in tables_in(path) if file.match(pattern)]
        return tables if len(tables) > 1 else [path]
    if kind == "bags":
        files = bag_files(path)
        return [path] if _follow(files, topics.max_jump_s) else files
    return [path]


def inner_logs(path: Path) -> list[Path]:
    """The folders in a folder, at any depth, that are logs; none if it is one itself."""
    if not path.is_dir() or is_log(path):
        return []
    folders = sorted((item for item in path.iterdir() if item.is_dir()), key=natural)
    return [log for folder in folders for log in ([folder] if is_log(folder) else inner_logs(folder))]


def _follow(files: Sequence[Path], most_s: float) -> bool:
    """Whether bag files are pieces of one recording: each begins where the last one ended, or not much later."""
    spans = sorted(span for file in files if (span := span_of(file)) != (0, 0))
    gaps = [(after[0] - before[1]) / 1e9 for before, after in itertools.pairwise(spans)]
    return all(-_SHARED_S <= gap <= most_s for gap in gaps)


def span_of(path: Path) -> tuple[int, int]:
    """First and last time of logging of a bag [ns]; zeros where it is empty."""
    with opened(path) as bag:
        return (bag.start_time, bag.start_time + bag.duration) if bag.message_count else (0, 0)
