"""Read back the named values that :func:`.mcap_writer.write_mcap` writes beside a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader

from legtool.datasets.logs.bagfile import opened
from legtool.datasets.logs.mcap_writer import NamedColumns
from legtool.errors import LogError


def read_named(path: Path, topic: str) -> NamedColumns:
    """The values of a topic of a recording, row by row.

    Raises:
        LogError: the file is damaged, or has no messages with named values on this topic.
    """
    with opened(path):  # says what is wrong with a file that cannot be read
        pass
    with AnyReader([path]) as reader:
        there = [c for c in reader.connections if c.topic == topic and c.msgtype == "sensor_msgs/msg/JointState"]
        messages: list[Any] = (
            [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(there)] if there else []
        )
    if not messages:
        raise LogError(f"{path}: no named values on {topic}; expected a recording that a suite of eval planner wrote")
    return NamedColumns(topic, tuple(messages[0].name), np.array([message.position for message in messages]))
