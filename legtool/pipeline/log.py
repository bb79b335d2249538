"""Collect transitions from a real robot's logs: one part per log, each read in bounded memory."""

from __future__ import annotations

import functools
import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from legtool.configs.log import LogSettings
from legtool.configs.robots import RobotGeometry, load_geometry
from legtool.configs.topics import TopicSettings, load_topics
from legtool.datasets.contents import files_content
from legtool.datasets.logs.bag import lacking
from legtool.datasets.logs.checks.compare import Evidence, compare
from legtool.datasets.logs.checks.finding import Finding, refused, warnings
from legtool.datasets.logs.checks.stance import check_regular
from legtool.datasets.logs.checks.windows import WindowCollector
from legtool.datasets.logs.formats import kind_of
from legtool.datasets.logs.log import LogReader
from legtool.datasets.logs.recording import Recording
from legtool.datasets.motion.stance import stance_motion
from legtool.datasets.motion.transitions import check_enough, cut_transitions
from legtool.datasets.provenance import commit
from legtool.datasets.store import Store, part_path, write_part
from legtool.errors import LogError
from legtool.pipeline.parts import run_parts

#: Share of a log's steps that another one may have too.
_COPIED = 0.2


def collect_log(paths: Sequence[Path], settings: LogSettings, out: Path, *, workers: int = 1) -> dict[str, Any]:
    """Cut logs into a dataset of transitions.

    Args:
        paths: ``.bag``, ROS 2 bag directory, ``.db3``, ``.mcap``, ``.csv`` or a directory of CSVs, in time order; bags
            of one run that complete each other stand side by side.
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
    identities = [_identify(path) for path in paths]
    _check_twins(paths, identities)
    inputs = [entry for identity in identities for entry in identity]
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
    with Store(out, header) as store, store.refusable():
        runs = find_runs(paths, topics)
        write = functools.partial(write_log_part, store.path, runs, settings)
        manifest = run_parts(store, write, total=len(runs), workers=workers, description="reading logs", unit="logs")
        check_enough(manifest["counts"])
        _check_copies(store.path, [run[0] for run in runs])
    return manifest


def find_runs(paths: Sequence[Path], topics: TopicSettings) -> list[tuple[Path, ...]]:
    """The logs by runs: bags that lack signals are joined with those after them, until nothing is lacking.

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
    open_run: list[Path] = []
    for path in paths:
        if not lacking([path], topics):
            runs += [(item,) for item in open_run] + [(path,)]
            open_run = []
        elif not lacking([*open_run, path], topics):
            runs.append((*open_run, path))
            open_run = []
        else:
            open_run.append(path)
    return runs + [(item,) for item in open_run]


def write_log_part(root: Path, runs: Sequence[tuple[Path, ...]], settings: LogSettings, index: int) -> None:
    """Cut run ``index`` of ``runs`` and write its part of the dataset below ``root``.

    Raises:
        LogError: its signals contradict each other, such that models learned from it would be wrong.
    """
    paths, topics = runs[index], load_topics(settings.topics)
    path = paths[0]
    robot = load_geometry(settings.robot)
    cut = cut_log(paths, topics, robot, settings, index)
    notes: list[str] = []
    empty = [finding for finding in cut.findings if finding.unfilled]
    if empty:
        notes = [f"{finding.text.partition(';')[0]}; it was derived" for finding in empty]
        topics = topics.replace(**{finding.signal: None for finding in empty})
        cut = cut_log(paths, topics, robot, settings, index)
    if reason := refused(cut.findings):
        raise LogError(reason if reason.startswith(str(path)) else f"{path}: {reason}")
    notes += warnings(cut.findings)
    write_part(
        part_path(root, index),
        cut.table,
        counts={"logs": 1, **cut.counts},
        notes=[f"{path.name}: {note}" for note in notes],
    )


class Cut(NamedTuple):
    """A log's steps, how many of which kind, and what its signals say of each other."""

    table: pa.Table
    counts: dict[str, float]
    findings: list[Finding]


def cut_log(
    paths: Sequence[Path], topics: TopicSettings, robot: RobotGeometry, settings: LogSettings, index: int
) -> Cut:
    """Read a log once: its steps, and what its signals say of each other."""
    reader = LogReader(
        paths,
        topics,
        robot.geometry(),
        messages=settings.msgs,
        joint_offset=robot.joint_offset,
        split_at_jumps=settings.split_at_jumps,
    )
    chunks = _explained(reader)
    first = next(chunks)
    gap_s = reader.facts.gap_ns * 1e-9
    topics = reader.topics
    collector = WindowCollector(gap_s=max(gap_s, settings.transitions.max_step_s) if topics.events else gap_s)

    def watched() -> Iterator[Recording]:
        for recording in itertools.chain([first], chunks):
            collector.add(recording)
            yield recording

    transitions = settings.transitions
    if not topics.events:
        transitions = transitions.replace(gap_s=min(transitions.gap_s, gap_s))
    tables, counts = [], Counter[str]()
    for number, (_, session) in enumerate(itertools.groupby(watched(), key=lambda recording: recording.name)):
        table, found = cut_transitions(session, transitions, episode=f"{index}.{number}" if number else index)
        tables.append(table)
        counts.update(found)
    table = pa.concat_tables(tables)
    seconds = table.column("duration_s").to_numpy()
    step_s = float(np.median(seconds)) if len(seconds) else None
    findings = check_regular(counts) + compare(
        Evidence(reader.facts, collector.windows(), step_s, stance_motion(table)), topics, reader.robot
    )
    return Cut(table, {**dict(counts), **reader.facts.counts()}, findings)


def _explained(reader: LogReader) -> Iterator[Recording]:
    """The recordings of a log; where they cannot be read, the stamps may know why."""
    try:
        yield from reader.recordings()
    except LogError as error:
        evidence = Evidence(reader.facts, WindowCollector(gap_s=1.0).windows(), None)
        reason = refused(compare(evidence, reader.topics, reader.robot))
        if reason is None:
            raise
        raise LogError(f"{reader.path}: {reason}") from error


def _identify(path: Path) -> list[dict[str, Any]]:
    """Name and hash of each file of a log, so that a dataset knows what it was made from."""
    if not path.exists():
        raise LogError(f"{path}: no such log")
    return files_content(path)


def _check_copies(root: Path, paths: Sequence[Path]) -> None:
    """Refuse a recording that is given again in another format: the same steps at the same places and times."""
    seen: dict[tuple[int, float], int] = {}
    for index, path in enumerate(paths):
        table = pq.read_table(part_path(root, index), columns=["stamp_ns", "position_x"])
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
