"""The steps of one log, and what its signals say of each other: read once, in bounded memory."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from legtool.configs.log import LogSettings
from legtool.configs.robots import RobotGeometry
from legtool.configs.topics import TopicSettings
from legtool.datasets.logs.checks.compare import Evidence, compare
from legtool.datasets.logs.checks.finding import Finding, refused
from legtool.datasets.logs.checks.stance import check_regular
from legtool.datasets.logs.checks.windows import WindowCollector
from legtool.datasets.logs.log import LogReader
from legtool.datasets.logs.recording import Recording
from legtool.datasets.motion.stance import stance_motion
from legtool.datasets.motion.transitions import cut_transitions
from legtool.errors import LogError


def cut_filled(
    paths: Sequence[Path], topics: TopicSettings, robot: RobotGeometry, settings: LogSettings, index: int
) -> tuple[Cut, list[str]]:
    """Read a log as :func:`cut_log` does; signals that were never filled are derived, and told."""
    cut = cut_log(paths, topics, robot, settings, index)
    empty = [finding for finding in cut.findings if finding.unfilled]
    if not empty:
        return cut, []
    topics = topics.replace(**{finding.signal: None for finding in empty})
    notes = [f"{finding.text.partition(';')[0]}; it was derived" for finding in empty]
    return cut_log(paths, topics, robot, settings, index), notes


class Cut(NamedTuple):
    """A log's steps, how many of which kind, and what its signals say of each other."""

    table: pa.Table
    counts: dict[str, float]
    findings: list[Finding]


def cut_log(
    paths: Sequence[Path],
    topics: TopicSettings,
    robot: RobotGeometry,
    settings: LogSettings,
    index: int,
    *,
    most_s: float | None = None,
) -> Cut:
    """Read a log once, or about its first ``most_s``: its steps, and what its signals say of each other."""
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
            if most_s is not None and recording.stamps_ns[0] - first.stamps_ns[0] > most_s * 1e9:
                return
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
