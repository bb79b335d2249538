"""Look through a log without knowing what is in it: rates, gaps, clocks, and which signals each topic could serve."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rosbags.interfaces import Connection

from legtool.datasets.logs.bagfile import check_encoding, definitions, guarded, is_json, is_ros1, opened
from legtool.datasets.logs.fields import STANDARD
from legtool.datasets.logs.jointnames import joint_order
from legtool.datasets.logs.json_messages import json_groups
from legtool.datasets.logs.layout import Bytes, Layout, walk
from legtool.errors import LogError

#: Signals that messages of arrays can serve, by what their topics are called.
_NAMED = {"contact": ("contact", "force", "foot"), "command": ("cmd", "command"), "feet": ("feet", "foot_pos")}


#: Types of large messages, which serve nothing here.
_LARGE = re.compile("Image|PointCloud|OccupancyGrid|GridMap|LaserScan|Video|Marker")


class TopicSurvey(NamedTuple):
    """A topic of a bag.

    Attributes:
        name: of the topic.
        msgtype: type of its messages.
        messages: their number.
        rate_hz: usual rate [Hz]; 0 where it is not known.
        longest_gap_s: longest time between two messages [s].
        offset_s: header stamp minus time of logging of the first message [s]; None without header.
        serves: signals that its messages could be.
        elements: names of its elements, such as joints or models.
        note: why it cannot be read; empty if it can.
    """

    name: str
    msgtype: str
    messages: int
    rate_hz: float
    longest_gap_s: float
    offset_s: float | None
    serves: tuple[str, ...]
    elements: tuple[str, ...] = ()
    note: str = ""


def survey(*paths: Path, messages: Path | None = None) -> list[TopicSurvey]:
    """Survey the topics of a bag, or of several of one run. Messages of topics that serve nothing are not read.

    Raises:
        LogError: a bag is damaged.
    """
    with opened(*paths) as reader:
        held = [connection for connection in reader.connections if connection.msgcount]
        if not held:
            raise LogError(f"{paths[0]}: holds no messages; was anything recorded?")
        layouts: dict[str, Layout | None] = {}
        notes: dict[str, str] = {}
        stamps: dict[str, list[int]] = {connection.topic: [] for connection in held}
        offsets: dict[str, float] = {}
        wanted = [connection for connection in held if not _LARGE.search(connection.msgtype)]
        for connection, stamp, raw in guarded(paths[0], reader.messages(wanted)):
            stamps[connection.topic].append(stamp)
            if connection.topic not in layouts:
                layouts[connection.topic] = None
                try:
                    check_encoding(connection, paths[0])
                    layout, matrix = _first(connection, bytes(raw), messages, paths[0])
                except LogError as error:
                    notes[connection.topic] = str(error).partition(": ")[2]
                    continue
                layouts[connection.topic] = layout
                if "header.stamp.sec" in layout.leaves:
                    seconds = int(layout.take(matrix, "header.stamp.sec")[0, 0])
                    header = seconds * 10**9 + int(layout.take(matrix, "header.stamp.nanosec")[0, 0])
                    offsets[connection.topic] = (header - stamp) * 1e-9
    out: dict[str, TopicSurvey] = {}
    for connection in sorted(held, key=lambda c: c.topic):
        name = connection.topic
        steps = np.diff(np.array(stamps[name], dtype=np.int64)) * 1e-9
        usual = float(np.median(steps)) if len(steps) else 0.0
        count = connection.msgcount + (out[name].messages if name in out else 0)
        out[name] = TopicSurvey(
            name,
            connection.msgtype,
            count,
            1.0 / usual if usual > 0 else 0.0,
            float(steps.max()) if len(steps) else 0.0,
            offsets.get(name),
            _serves(name, connection.msgtype, layouts.get(name)),
            _elements(layouts.get(name)),
            notes.get(name, ""),
        )
    return list(out.values())


def _first(connection: Connection, raw: bytes, messages: Path | None, path: Path) -> tuple[Layout, Bytes]:
    """Layout and bytes (1, size) of a topic's first message."""
    if is_json(connection):
        _, layout, matrix = next(iter(json_groups([raw])))
        return layout, matrix
    layout = walk(raw, definitions([connection], messages, path), connection.msgtype, ros1=is_ros1(connection))
    return layout, np.frombuffer(raw, dtype=np.uint8)[None]


def _elements(layout: Layout | None) -> tuple[str, ...]:
    return () if layout is None else tuple(layout.names.values())


def _serves(topic: str, msgtype: str, layout: Layout | None) -> tuple[str, ...]:
    """The signals that a topic's type allows, and its name where the type allows everything."""
    if layout is None:
        return ()
    known = STANDARD.get(msgtype, {})
    if "MultiArray" in msgtype or msgtype.startswith("std_msgs/"):
        low = topic.lower()
        return tuple(name for name, words in _NAMED.items() if any(word in low for word in words))
    if msgtype == "sensor_msgs/msg/JointState":
        names = [text for path, text in layout.names.items() if path.startswith("name.")]
        return ("joints",) if joint_order(names, ()) is not None else ()
    if "command" in known and "cmd" not in topic.lower() and "command" not in topic.lower():
        return tuple(name for name in known if name != "command")
    if "command" in known and "position" not in known:
        return ("command",)
    return tuple(name for name in known if name != "command" or "position" not in known)


def describe_survey(topics: list[TopicSurvey]) -> list[str]:
    """A line for each topic, for a terminal."""
    lines = []
    for topic in topics:
        parts = [f"  {topic.name}: {topic.messages} {topic.msgtype}"]
        if topic.rate_hz:
            parts.append(f"{topic.rate_hz:.4g} Hz, longest gap {topic.longest_gap_s:.3g} s")
        if topic.offset_s is not None:
            parts.append(f"header stamps {topic.offset_s:+.3g} s off the log's time")
        if topic.serves:
            parts.append(f"could be {', '.join(topic.serves)}")
        if topic.note:
            parts.append(topic.note)
        lines.append("; ".join(parts))
    return lines
