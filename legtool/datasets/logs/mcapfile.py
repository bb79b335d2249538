"""Read MCAP files that are no plain ROS 2 recordings: other profiles, ROS 1 messages, foreign channels."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.records import Channel, Schema
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat

_FORMATS = {
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros1msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
    "omgidl": MessageDefinitionFormat.IDL,
}


class McapFile:
    """An MCAP file of any profile, with the interface of a bag."""

    def __init__(self, path: Path) -> None:
        """Open a file and read its summary.

        Raises:
            Exception: whatever the parser raises where the file is damaged.
        """
        self._file = path.open("rb")
        try:
            self._reader = make_reader(self._file)
            summary = self._reader.get_summary()
            if summary is None or summary.statistics is None:
                raise ValueError("it has no summary; rebuild it with 'mcap recover'")
            counts = summary.statistics.channel_message_counts
            self.message_count: int = summary.statistics.message_count
            self.start_time: int = summary.statistics.message_start_time
            self.duration: int = summary.statistics.message_end_time - self.start_time
            self._channels = {
                number: self._connection(channel, summary.schemas.get(channel.schema_id), counts.get(number, 0))
                for number, channel in summary.channels.items()
            }
        except BaseException:
            self._file.close()
            raise

    @property
    def connections(self) -> list[Connection]:
        """All channels."""
        return list(self._channels.values())

    def messages(self, connections: Sequence[Connection]) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield connection, time of logging [ns] and serialised message, in the order of time."""
        topics = {connection.topic for connection in connections}
        wanted = {connection.id for connection in connections}
        for _, channel, message in self._reader.iter_messages(topics=list(topics)):
            if channel.id in wanted:
                yield self._channels[channel.id], message.log_time, message.data

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _connection(self, channel: Channel, schema: Schema | None, count: int) -> Connection:
        name = schema.name if schema is not None else "unknown"
        if name.count("/") == 1:  # as ROS 1 names its types
            name = name.replace("/", "/msg/")
        encoding = schema.encoding if schema is not None else ""
        kind = _FORMATS.get(encoding, MessageDefinitionFormat.NONE)
        text = schema.data.decode("utf-8", "replace") if schema is not None and encoding in _FORMATS else ""
        ext: Any = ConnectionExtRosbag2(channel.message_encoding, [])
        return Connection(channel.id, channel.topic, name, MessageDefinition(kind, text), "", count, ext, self)
