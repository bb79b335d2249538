"""Read a robot's log of any supported format as a stream of recordings on one clock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from legtool.configs.topics import TopicSettings
from legtool.datasets.logs.align import Aligner
from legtool.datasets.logs.checks.compare import HELD
from legtool.datasets.logs.derive import Deriver
from legtool.datasets.logs.facts import LogFacts
from legtool.datasets.logs.formats import kind_of
from legtool.datasets.logs.recording import Recording
from legtool.datasets.logs.signals import Array, Samples
from legtool.errors import LogError
from legtool_runtime.robot import Robot


class Log(Protocol):
    """A log as streams of samples; ``labels`` names each stream in error messages."""

    name: str
    labels: dict[str, str]

    def batches(self, seconds: float) -> Iterator[dict[str, Samples] | None]:
        """Yield the samples of all streams, in pieces of about ``seconds`` each; None where time begins anew."""
        ...


class LogReader:
    """Reads one log in bounded memory.

    Attributes:
        facts: what was noticed so far; complete once all recordings are read.
    """

    def __init__(
        self,
        path: Path | Sequence[Path],
        topics: TopicSettings,
        robot: Robot,
        *,
        messages: Path | None = None,
        joint_offset: Array | None = None,
        split_at_jumps: bool = False,
    ) -> None:
        """Open a log.

        Args:
            path: ROS 1 ``.bag``, ROS 2 bag directory, ``.db3``, ``.mcap``, ``.csv``, a directory of bag or CSV files,
                or several bags of one run, which are joined by their stamps.
            topics: where its signals are.
            robot: the robot of the log; its kinematics give the feet if the log contains only joints.
            messages: directory of custom ``.msg`` definitions.
            joint_offset: what is added to the robot's own joint angles to get ours: (12,) [rad].
            split_at_jumps: whether stamps may jump: what lies beyond is another recording, whose name has a number.

        Raises:
            LogError: the log is missing, damaged or empty, or lacks a signal that cannot be derived.
        """
        paths = [path] if isinstance(path, Path) else list(path)
        self.path, self.robot, self.joint_offset = paths[0], robot, joint_offset
        if topics.alternatives and all(kind_of(item) != "csv" for item in paths):
            from legtool.datasets.logs.bag import topics_in

            topics = topics.choose(topics_in(paths))
        self.topics = topics
        self.max_jump_ns = int(topics.max_jump_s * 1e9) if split_at_jumps else None
        self.facts = LogFacts(split=split_at_jumps)
        self.log = open_log(paths, topics, self.facts, messages=messages)

    def recordings(self, chunk_s: float = 60.0) -> Iterator[Recording]:
        """Yield consecutive stretches of the log, all named after it. The next one may follow without a gap.

        Args:
            chunk_s: length of a recording [s]; it ends earlier at a gap in the log.

        Raises:
            LogError: the log is damaged, empty or implausible.
        """
        session, last_ns, found = 0, None, 0
        try:
            for sampled in _sessions(self.log.batches(chunk_s)):
                aligner, deriver = self._stages()
                for batch in sampled:
                    for recording in deriver.push(aligner.push(batch, final=batch is None), final=batch is None):
                        start = int(recording.stamps_ns[0])
                        if last_ns is not None and self.max_jump_ns is not None:
                            session += not 0 <= start - last_ns <= self.max_jump_ns
                        last_ns = int(recording.stamps_ns[-1])
                        yield replace(recording, name=f"{recording.name}#{session}") if session else recording
                found += aligner.count
        except LogError as error:
            raise error if str(error).startswith(str(self.path)) else LogError(f"{self.path}: {error}") from error
        if not found:
            raise LogError(f"{self.path}: no instant has every signal: {aligner.explain()}")

    def _stages(self) -> tuple[Aligner, Deriver]:
        topics, log, age = self.topics, self.log, self.topics.command.max_age_s
        aligner = Aligner(
            log.labels,
            clock="position",
            held=HELD,
            max_gap_ns=int(topics.max_gap_s * 1e9),
            max_age_ns=None if age is None else int(age * 1e9),
            facts=self.facts,
        )
        return aligner, Deriver(log.name, topics, self.robot, log.labels, self.facts, self.joint_offset)


def _sessions(batches: Iterator[dict[str, Samples] | None]) -> Iterator[Iterator[dict[str, Samples] | None]]:
    """Batches by sessions, which None divides; each session ends with None."""
    ended = False

    def session() -> Iterator[dict[str, Samples] | None]:
        nonlocal ended
        for batch in batches:
            if batch is None:
                yield None
                return
            yield batch
        ended = True
        yield None

    while not ended:
        yield session()


def read_log(
    path: Path,
    topics: TopicSettings,
    robot: Robot,
    *,
    messages: Path | None = None,
    chunk_s: float = 60.0,
) -> Iterator[Recording]:
    """Read one log as :class:`LogReader` does, without what was noticed on the way."""
    yield from LogReader(path, topics, robot, messages=messages).recordings(chunk_s)


def open_log(paths: Sequence[Path], topics: TopicSettings, facts: LogFacts, *, messages: Path | None = None) -> Log:
    """Return the reader for a log's format.

    Raises:
        LogError: there is no such file, its format is unknown, or the topics describe another format.
    """
    path = paths[0]
    kinds = {kind_of(item) for item in paths}
    if "csv" in kinds:
        from legtool.datasets.logs.tabular import TableLog

        if len(paths) > 1:
            raise LogError(f"{path}: tables of one run are joined in one directory, whose files csv.files names")
        return TableLog(path, topics, facts)
    if topics.csv is not None:
        raise LogError(
            f"{path}: is a bag, but topics {topics.name!r} describe CSV columns; choose a preset such as ros2_standard"
        )
    from legtool.datasets.logs.bag import BagLog

    return BagLog(paths, topics, facts, messages=messages)


def describe_log(path: Path) -> dict[str, Any]:
    """Describe the contents of a log; neither robot nor topics need to be known.

    Returns:
        ``kind``; for bags also ``duration_s``, ``start_ns``, ``messages`` and ``topics`` (name: type and count), for
        CSV also ``files`` (name: rows and columns).

    Raises:
        LogError: the log is missing or damaged.
    """
    kind = kind_of(path)
    if kind == "csv":
        from legtool.datasets.logs.tablefiles import describe_tables

        return {"kind": kind, **describe_tables(path)}
    from legtool.datasets.logs.bagfile import describe_bag

    return {"kind": kind, **describe_bag(path)}
