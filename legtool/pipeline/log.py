"""Collect transitions from a real robot's logs: one part per log, each read in bounded memory."""

from __future__ import annotations

import functools
import itertools
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from legtool.configs.log import LogSettings
from legtool.configs.robots import PRESETS, load_geometry
from legtool.configs.topics import TopicSettings, load_topics
from legtool.datasets.contents import files_content
from legtool.datasets.logs.bag import lacking, topics_in
from legtool.datasets.logs.checks.finding import refused, warnings
from legtool.datasets.logs.formats import kind_of
from legtool.datasets.motion.from_log import cut_filled
from legtool.datasets.motion.transitions import check_enough
from legtool.datasets.store import Store, part_path, read_part, write_part
from legtool.errors import LogError
from legtool.pipeline.folders import logs_in, span_of
from legtool.pipeline.parts import run_parts
from legtool.provenance import commit
from legtool.workers import Workers

#: Share of a log's steps that another one may have too.
_COPIED = 0.2


def collect_log(
    paths: Sequence[Path], settings: LogSettings, out: Path, *, workers: int | Workers = 1
) -> dict[str, Any]:
    """Cut logs into a dataset of transitions.

    Args:
        paths: ``.bag``, ROS 2 bag directory, ``.db3``, ``.mcap``, ``.csv``, a directory of CSVs or a folder of logs, in
            time order; bags of one run that complete each other stand side by side.
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
    robot = load_geometry(settings.robot).geometry()
    topics = load_topics(settings.topics)
    paths = [log for path in paths for log in logs_in(path, topics)]
    identities = [files_content(path) for path in paths]
    _check_named(paths, topics, settings)
    _check_twins(paths, identities)
    inputs = [entry for identity in identities for entry in identity]
    if settings.msgs is not None and settings.msgs.exists():
        inputs += files_content(settings.msgs)
    header = {
        "kind": "motion",
        "robot": robot.to_dict(),
        "settings": {**settings.to_dict(), "topics": topics.replace(depth=None).to_dict()},
        "inputs": inputs,
        "instant": "touchdown" if topics.events else settings.transitions.instant,
        "commit": commit(),
    }
    with Store(out, header, shard=Workers.of(workers).name) as store, store.refusable():
        runs = find_runs(paths, topics)
        write = functools.partial(write_log_part, store.path, runs, settings)
        manifest = run_parts(store, write, total=len(runs), workers=workers, description="reading logs", unit="logs")
        check_enough(manifest["counts"])
        _check_copies(store.path, [run[0] for run in runs])
    return manifest


def find_runs(paths: Sequence[Path], topics: TopicSettings) -> list[tuple[Path, ...]]:
    """The logs by runs: bags that lack signals are joined with others of the same time, until nothing is lacking.

    Args:
        paths: logs in the order in which they were given.
        topics: where their signals are.

    Returns:
        the logs of each run; a log that lacks nothing, or lacks signals that no other has, is alone.

    Raises:
        LogError: a log is damaged, or none at all.
    """
    if len(paths) == 1 or any(kind_of(path) == "csv" for path in paths) or topics.csv is not None:
        return [(path,) for path in paths]
    runs: list[tuple[Path, ...]] = []
    left: list[Path] = []
    spans = {path: span_of(path) for path in paths} if len(paths) > 2 else {}
    for path in paths:
        meanwhile = [other for other in left if not spans or _overlap(spans[other], spans[path])]
        if not lacking([path], topics):
            runs.append((path,))
        elif not lacking([*meanwhile, path], topics):
            runs.append((*meanwhile, path))
            left = [other for other in left if other not in meanwhile]
        else:
            left.append(path)
    if len(left) > 1 and not lacking(left, topics):
        return [*runs, tuple(left)]  # on clocks that do not overlap; what reads them says so
    return sorted(runs + [(path,) for path in left], key=lambda run: list(paths).index(run[0]))


def _overlap(a: tuple[int, int], b: tuple[int, int]) -> bool:
    return a[0] <= b[1] and b[0] <= a[1]


def write_log_part(root: Path, runs: Sequence[tuple[Path, ...]], settings: LogSettings, index: int) -> None:
    """Cut run ``index`` of ``runs`` and write its part of the dataset below ``root``.

    Raises:
        LogError: its signals contradict each other, such that models learned from it would be wrong.
    """
    paths, topics = runs[index], load_topics(settings.topics)
    path = paths[0]
    robot = load_geometry(settings.robot)
    cut, notes = cut_filled(paths, topics, robot, settings, index)
    if reason := refused(cut.findings):
        raise LogError(reason if reason.startswith(str(path)) else f"{path}: {reason}")
    notes += warnings(cut.findings)
    write_part(
        part_path(root, index),
        cut.table,
        counts={"logs": 1, **cut.counts},
        notes=[f"{path.name}: {note}" for note in notes],
    )


def _check_named(paths: Sequence[Path], topics: TopicSettings, settings: LogSettings) -> None:
    """Refuse joint angles without a named robot: another one's lengths would give feet that look almost right."""
    if "robot" in settings.model_fields_set:
        return
    if topics.csv is None and all(kind_of(path) != "csv" for path in paths):
        topics = topics.choose(topics_in(paths))
    if topics.feet is None:
        presets = ", ".join(sorted(preset.stem for preset in PRESETS.glob("*.yaml")))
        raise LogError(
            f"{paths[0]}: feet come from joint angles by a robot's lengths, and no robot is named; name it with "
            f"--robot (a YAML file, or one of: {presets}), or see whose the log could be with --guess"
        )


def _check_copies(root: Path, paths: Sequence[Path]) -> None:
    """Refuse a recording that is given again in another format: the same steps at the same places and times."""
    seen: dict[tuple[int, float], int] = {}
    for index, path in enumerate(paths):
        table = read_part(part_path(root, index), ["stamp_ns", "position_x"])
        keys = list(zip(table.column(0).to_pylist(), table.column(1).to_pylist(), strict=True))
        shared = Counter(seen[key] for key in keys if key in seen)
        for other, count in shared.items():
            if count > _COPIED * len(keys):
                raise LogError(f"{path}: holds the same steps as {paths[other]}; give each recording once")
        seen.update(dict.fromkeys(keys, index))


def _check_twins(paths: Sequence[Path], identities: Sequence[list[dict[str, Any]]]) -> None:
    """Refuse a recording that is given twice: a held-out step would have its twin in the fit."""
    held = [
        {entry["sha256"] for entry in identity if Path(entry["name"]).suffix not in (".yaml", ".txt")}
        for identity in identities
    ]
    for (i, a), (j, b) in itertools.combinations(enumerate(held), 2):
        if a and b and (a <= b or b <= a):
            what = f"{paths[i]} and {paths[j]}" if paths[i] != paths[j] else f"{paths[i]} (given twice)"
            raise LogError(f"{what}: are the same recording (equal SHA-256); give each recording once")
