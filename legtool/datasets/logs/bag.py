"""Read ROS bags through rosbags. Only the topics that are needed are decoded, many messages at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection

from legtool.configs.topics import Contact, Joints, LegSignal, Orientation, Signal, TopicSettings
from legtool.datasets.logs.bagfile import blocks, definitions, is_json, is_ros1, opened
from legtool.datasets.logs.facts import LogFacts, StreamFacts, TopicClock
from legtool.datasets.logs.fields import find_signal, json_number
from legtool.datasets.logs.jointnames import joint_order
from legtool.datasets.logs.json_messages import json_groups
from legtool.datasets.logs.layout import Bytes, Layout, groups
from legtool.datasets.logs.signals import MAX_LATE_NS, Array, Samples, Stamps, check_stamps, lost_rows, to_si, width
from legtool.errors import LogError

#: Bytes of messages that are decoded at once. This bounds the memory at any message rate.
BATCH = 32 * 2**20


@dataclass
class _Stream:
    """One signal, or one leg's share of it, on one topic."""

    name: str
    signal: Signal
    numbers: int
    label: str
    latest: int | None = None
    seen: int = 0
    element: str | None = None
    text: bool = False


@dataclass
class _Topic:
    """A topic that is read, and what of it."""

    name: str
    connections: list[Connection]
    streams: list[_Stream] = field(default_factory=list)
    count: int = 0

    @property
    def msgtype(self) -> str:
        return self.connections[0].msgtype

    @property
    def ros1(self) -> bool:
        return is_ros1(self.connections[0])

    @property
    def where(self) -> str:
        """Its name in error messages."""
        kind = ", JSON" if is_json(self.connections[0]) else ""
        return f"topic {self.name} ({self.msgtype}{kind})"

    def groups(
        self, raws: Sequence[bytes | memoryview], types: dict[str, Any]
    ) -> Iterator[tuple[NDArray[np.intp], Layout, Bytes]]:
        """Its messages in groups that share a layout."""
        if is_json(self.connections[0]):
            return json_groups(raws)
        return groups(raws, types, self.msgtype, ros1=self.ros1)


class BagLog:
    """A bag as streams of samples.

    Attributes:
        labels: the name of each stream in error messages; a stream of a single leg has a name such as ``contact/FL``.
    """

    def __init__(
        self, paths: Sequence[Path], topics: TopicSettings, facts: LogFacts, *, messages: Path | None = None
    ) -> None:
        """Open a bag, or several of one run, and find its topics.

        Raises:
            LogError: the bag is damaged or empty, or lacks a topic that is needed.
        """
        path = paths[0]
        self.paths, self.path, self.topics = tuple(paths), path, topics
        self.name = "+".join(item.name for item in paths)
        self.max_jump_ns = 2**62 if facts.split else int(topics.max_jump_s * 1e9)
        with opened(*paths) as reader:
            if not reader.message_count:
                raise LogError(f"{path}: holds no messages; was anything recorded?")
            there: dict[str, list[Connection]] = {}
            for connection in reader.connections:
                there.setdefault(connection.topic, []).append(connection)
            self.read = _choose(path, topics, there)
            self.types = definitions([c for topic in self.read for c in topic.connections], messages, path)
        self.labels = {stream.name: stream.label for topic in self.read for stream in topic.streams}
        self._joint_names: list[str] | None = None
        self.facts = facts
        for topic in self.read:
            facts.streams.update({stream.name: StreamFacts(stream.label) for stream in topic.streams})

    def batches(self, seconds: float) -> Iterator[dict[str, Samples]]:
        """Yield the samples of all streams, in pieces of about ``seconds`` each.

        Raises:
            LogError: a message is damaged or contains an impossible value.
        """
        step = int(seconds * 1e9)
        with opened(*self.paths) as reader:
            pending: dict[str, tuple[list[int], list[bytes | memoryview]]] = {t.name: ([], []) for t in self.read}
            names = {topic.name for topic in self.read}
            connections = [c for c in reader.connections if c.topic in names]
            until: int | None = None
            size = 0
            for block in blocks(self.path, reader.messages(connections)):
                for connection, stamp, raw in block:
                    stamps, raws = pending[connection.topic]
                    stamps.append(stamp)
                    raws.append(raw)
                    size += len(raw)
                last = block[-1][1]
                if until is None:
                    until = block[0][1] + step
                if last >= until or size >= BATCH:
                    yield self._decode(pending)
                    until, size = last + step, 0
            yield self._decode(pending)
        self._check_complete()

    def _check_complete(self) -> None:
        for topic in self.read:
            expected = sum(connection.msgcount for connection in topic.connections)
            if topic.count < expected and self.path.suffix.lower() == ".mcap":
                fixed = f"{self.path.stem}_recovered.mcap"
                raise LogError(
                    f"topic {topic.name}: {topic.count} messages can be reached, the summary counts {expected}, "
                    f"so the index is incomplete; rebuild it with 'mcap recover {self.name} -o {fixed}'"
                )
            for stream in topic.streams:
                if not stream.seen and isinstance(stream.signal, Joints) and self._joint_names:
                    listed = ", ".join(self._joint_names[:12])
                    raise LogError(
                        f"{stream.label}: no message names the robot's 12 joints; give their names in leg order "
                        f"(joints: {{names: […]}}); names there: {listed}"
                    )

    def _decode(self, pending: dict[str, tuple[list[int], list[bytes | memoryview]]]) -> dict[str, Samples]:
        out: dict[str, Samples] = {}
        for topic in self.read:
            stamps, raws = pending[topic.name]
            if raws:
                out.update(self._decode_topic(topic, np.array(stamps, dtype=np.int64), raws))
                pending[topic.name] = ([], [])
                topic.count += len(raws)
        return out

    def _decode_topic(self, topic: _Topic, log: Stamps, raws: list[bytes | memoryview]) -> dict[str, Samples]:
        stamps, header = log, np.zeros_like(log)
        found: dict[str, list[tuple[np.ndarray, Array]]] = {stream.name: [] for stream in topic.streams}
        try:
            for index, layout, rows in topic.groups(raws, self.types):
                if "header.stamp.sec" in layout.leaves:
                    header[index] = _nanoseconds(layout, rows)
                for stream in topic.streams:
                    values = self._values(topic, stream, layout, rows)
                    if values is None:
                        continue
                    told = ~np.isnan(values).any(axis=1) if stream.text else slice(None)  # other requests say nothing
                    found[stream.name].append((index[told], values[told]))
        except LogError as error:
            raise error if topic.name in str(error) else LogError(f"topic {topic.name}: {error}") from error
        keep = np.ones(len(log), dtype=np.bool_)
        if self._own_stamps(topic, header, log):
            stamps, keep = header, self._stamped(topic, header, log)
            unstamped = len(keep) - int(np.count_nonzero(keep))
            for stream in topic.streams if unstamped else ():
                self.facts.streams[stream.name].unstamped += unstamped
        joined = {stream.name: _joined(found[stream.name]) for stream in topic.streams if found[stream.name]}
        keep &= self._held(topic, joined, len(log))
        return {
            stream.name: samples
            for stream in topic.streams
            if stream.name in joined
            and (samples := self._samples(stream, stamps, keep, *joined[stream.name])) is not None
        }

    def _held(self, topic: _Topic, joined: dict[str, tuple[np.ndarray, Array]], count: int) -> NDArray[np.bool_]:
        """Messages (count,) that hold values; a pose whose orientation is lost has no position either."""
        held = np.ones(count, dtype=np.bool_)
        for stream in topic.streams:
            if stream.name in joined:
                index, raw = joined[stream.name]
                held[index[lost_rows(stream.signal, raw)]] = False
        if not held.all():
            for stream in topic.streams:
                self.facts.streams[stream.name].lost += count - int(np.count_nonzero(held))
        return held

    def _values(self, topic: _Topic, stream: _Stream, layout: Layout, rows: Bytes) -> Array | None:
        where = topic.where
        name = stream.name.split("/")[0]
        place = find_signal(name, stream.signal, topic.msgtype, layout, where)
        if place.absent:
            return np.zeros((len(rows), stream.numbers))
        paths, stream.text = list(place.paths), bool(place.json)
        self._check_names(stream, layout, paths, where)
        if isinstance(stream.signal, Orientation) and sorted(path[-2:] for path in paths) == [".w", ".x", ".y", ".z"]:
            paths = [f"{paths[0][:-1]}{letter}" for letter in stream.signal.order]
        parts = [layout.values(rows, paths)] if paths else []
        parts += [_from_text(layout, rows, *text) for text in place.json]
        values = np.concatenate(parts, axis=1)
        if isinstance(stream.signal, Joints) and (names := _names_beside(layout, paths)):
            order = joint_order(names, stream.signal.names)
            if order is None or len(names) != values.shape[1]:
                self._joint_names = names
                return None  # another publisher's joints, such as an arm's
            values = values[:, order]
        elif isinstance(stream.signal, Contact) and values.shape[1] > stream.numbers and not values.shape[1] % 3:
            values = _magnitudes(values, stream.numbers)
        if values.shape[1] != stream.numbers:
            raise LogError(
                f"{where}: {', '.join(paths[:4])} hold {values.shape[1]} numbers for {stream.name}, expected "
                f"{stream.numbers}; name them: a list of fields, or a range such as motor_state.0-11.q"
            )
        return values

    def _check_names(self, stream: _Stream, layout: Layout, paths: list[str], where: str) -> None:
        """Refuse an index that points at another model or link than it did at first."""
        name = layout.name_at(paths[0]) if paths and not isinstance(stream.signal, Joints) else None
        if name is None:
            return
        if stream.element is None:
            stream.element = name
        elif stream.element != name:
            first, index = stream.element, next(part for part in paths[0].split(".") if part.isdigit())
            field = ".".join(first if part == index else part for part in str(stream.signal.field).split("."))
            raise LogError(
                f"{where}: {stream.signal.field} is {first!r} at first and {name!r} later; choose it by its name: "
                f"{stream.name}: {{field: {field}}}"
            )

    def _own_stamps(self, topic: _Topic, header: Stamps, log: Stamps) -> bool:
        """Whether a topic's header stamps are used. Decided by its first messages, and kept."""
        clock = self.facts.clocks.get(topic.name)
        if clock is None:
            given = {stream.signal.stamps for stream in topic.streams} - {None} or {self.topics.stamps}
            if len(given) > 1:
                raise LogError(f"topic {topic.name}: its signals have different stamps; set the same for all of them")
            clock = self.facts.clocks[topic.name] = TopicClock(given == {"header"} and bool(header.any()))
        stamped = header != 0
        if stamped.any():
            clock.offsets_s.append(float(np.median(header[stamped] - log[stamped])) * 1e-9)
        return clock.own

    def _stamped(self, topic: _Topic, header: Stamps, log: Stamps) -> NDArray[np.bool_]:
        """Whether headers have a stamp; 0 is one where time begins with the log."""
        offset = self.facts.clocks[topic.name].offset_s or 0.0
        return (header != 0) | (np.abs(log + round(offset * 1e9)) < MAX_LATE_NS)

    def _samples(
        self, stream: _Stream, stamps: Stamps, keep: NDArray[np.bool_], index: np.ndarray, raw: Array
    ) -> Samples | None:
        at = stamps[index]
        if not keep.all():
            at, raw = at[keep[index]], raw[keep[index]]
        if not len(at):
            return None

        def where(row: int) -> str:
            return f"{stream.label}, stamp {at[row] / 1e9:.6f} s"

        check_stamps(at, stream.latest, self.max_jump_ns, where)
        stream.latest = max(int(at.max()), stream.latest or int(at[0]))
        stream.seen += len(at)
        return Samples(at, to_si(stream.signal, raw, where))


def _names_beside(layout: Layout, paths: list[str]) -> list[str]:
    """Names that are listed beside an array of numbers, as in JointState, at any depth of the message."""
    beside = f"{paths[0].rpartition('.')[0]}.name.".lstrip(".") if paths else "?"
    return [text for path, text in layout.names.items() if path.startswith(beside)]


def _from_text(layout: Layout, rows: Bytes, path: str, keys: tuple[str, ...]) -> Array:
    return np.array([[json_number(layout.text(row, path), keys)] for row in rows])


def _magnitudes(forces: Array, legs: int) -> Array:
    """Magnitude of each leg's force (n, legs), from vectors (n, 3 k): those of one leg's contacts are added."""
    vectors = forces.reshape(len(forces), -1, 3)
    if legs == 1:
        vectors = vectors.sum(axis=1, keepdims=True)
    return np.linalg.norm(vectors, axis=2)


def _joined(parts: list[tuple[np.ndarray, Array]]) -> tuple[np.ndarray, Array]:
    """Groups of messages, put together in the order of the log: their numbers and values."""
    if len(parts) == 1:
        return parts[0]
    index = np.concatenate([part[0] for part in parts])
    raw = np.concatenate([part[1] for part in parts])
    order = np.argsort(index, kind="stable")
    return index[order], raw[order]


def topics_in(paths: Sequence[Path]) -> set[str]:
    """Topics of bags that hold messages."""
    with opened(*paths) as reader:
        return {connection.topic for connection in reader.connections if connection.msgcount}


def lacking(paths: Sequence[Path], topics: TopicSettings) -> set[str]:
    """Signals that have no messages in bags, of those that are needed.

    Raises:
        LogError: a bag is damaged.
    """
    return lacking_of(topics_in(paths), topics)


def lacking_of(there: Set[str], topics: TopicSettings) -> set[str]:
    """The same, by the topics that hold messages."""
    topics = topics.choose(there)
    absent = {name for name, signal in topics.signals().items() if not signal.topics <= there}
    needed = {name for name in absent if not topics.signals()[name].optional}
    return needed | ({"feet or joints"} if not topics.signals().keys() & {"feet", "joints"} - absent else set())


def _choose(path: Path, topics: TopicSettings, there: dict[str, list[Connection]]) -> list[_Topic]:
    """The topics to read, and what of each."""
    chosen: dict[str, _Topic] = {}
    absent: list[str] = []
    held: set[str] = set()
    for name, signal in topics.signals().items():
        wanted = (signal.topic,) if isinstance(signal.topic, str) else signal.topic or ()
        if len(wanted) not in (1, 4) or (len(wanted) == 4 and not isinstance(signal, LegSignal)):
            raise LogError(f"{path}: {name} names {len(wanted)} topics, expected one, or one for each leg")
        missing = [topic for topic in wanted if not any(c.msgcount for c in there.get(topic, ()))]
        if missing:
            if not signal.optional:
                absent += [f"{name} ({topic})" for topic in missing]
            continue
        held.add(name)
        for index, topic in enumerate(wanted):
            entry = chosen.setdefault(topic, _Topic(topic, there[topic]))
            if len({c.msgtype for c in there[topic]}) > 1:
                raise LogError(
                    f"{path}: topic {topic} holds messages of several types; record each type on its own topic"
                )
            numbers = width(name, signal) // len(wanted)
            leg = f"/{signal.legs[index]}" if isinstance(signal, LegSignal) and len(wanted) == 4 else ""
            entry.streams.append(_Stream(f"{name}{leg}", signal, numbers, f"{name} (topic {topic})"))
    if absent or not held & {"feet", "joints"}:
        listed = ", ".join(
            f"{topic} ({c[0].msgtype}, {sum(x.msgcount for x in c)} messages)" for topic, c in sorted(there.items())
        )
        raise LogError(
            f"{path}: holds nothing on a topic for {', '.join(absent) or 'feet or joints'}; topics there: "
            f"{listed}; name them in a YAML file for --topics"
        )
    return list(chosen.values())


def _nanoseconds(layout: Layout, rows: Bytes) -> Stamps:
    seconds = layout.take(rows, "header.stamp.sec")[:, 0].astype(np.int64)
    return seconds * 10**9 + layout.take(rows, "header.stamp.nanosec")[:, 0].astype(np.int64)
