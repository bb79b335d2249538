"""Open bag files, describe their contents, and explain what is wrong with a damaged one."""

from __future__ import annotations

import heapq
import itertools
import re
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol, TypeVar

from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore

import legtool.configs
from legtool.datasets.logs.formats import bag_suffix
from legtool.datasets.logs.unpacked import journal_of, openable
from legtool.errors import LogError

T = TypeVar("T")
_IDL_SEPARATOR = "=" * 80 + "\n"
#: Definitions of messages that come with legtool, for bags that hold none.
_SHIPPED = Path(legtool.configs.__file__).parent / "messages"
#: Messages that are taken from a bag at once: few, since some of them may be large.
_BLOCK = 64
_MAGIC = b"\x89MCAP0\r\n"


class Bag(Protocol):
    """An open bag, in whatever storage: topics with their types, and messages in the order of the log."""

    @property
    def connections(self) -> list[Connection]:
        """All topics; one may have several connections."""
        ...

    @property
    def message_count(self) -> int:
        """Number of messages on all topics."""
        ...

    @property
    def start_time(self) -> int:
        """Time of the first message [ns]."""
        ...

    @property
    def duration(self) -> int:
        """Time from the first message to the last [ns]."""
        ...

    def messages(self, connections: Sequence[Connection]) -> Generator[tuple[Connection, int, Any], None, None]:
        """Yield connection, time of logging [ns] and serialised message."""
        ...


class _Joined:
    """Several bags as one, messages in the order of their time of logging."""

    def __init__(self, bags: Sequence[Bag]) -> None:
        self.bags = bags
        self.connections = [connection for bag in bags for connection in bag.connections]
        held = [bag for bag in bags if bag.message_count]
        self.message_count = sum(bag.message_count for bag in held)
        self.start_time = min((bag.start_time for bag in held), default=0)
        self.duration = max((bag.start_time + bag.duration for bag in held), default=0) - self.start_time

    def messages(self, connections: Sequence[Connection]) -> Generator[tuple[Connection, int, Any], None, None]:
        """Yield messages as a bag does."""
        wanted = [(bag, [c for c in bag.connections if c in connections]) for bag in self.bags]
        streams = [bag.messages(chosen) for bag, chosen in wanted if chosen]
        yield from heapq.merge(*streams, key=lambda message: message[1])


@contextmanager
def opened(*paths: Path) -> Iterator[Bag]:
    """Open a bag, or several that are parts of one run, and yield a reader of them all.

    Args:
        paths: files, ROS 2 bag directories, or directories of bag files without metadata.

    Raises:
        LogError: a bag is empty, truncated or damaged; the message says how much can be recovered.
    """
    files = [file for path in paths for file in bag_files(path)]
    with ExitStack() as held:
        bags = [held.enter_context(_opened(held.enter_context(openable(file)), file)) for file in files]
        yield bags[0] if len(bags) == 1 else _Joined(bags)


def bag_files(path: Path) -> list[Path]:
    """A bag's file or its directory if that has metadata; all bag files of a directory without, or with a journal.

    Metadata count what was in a database before its recorder was killed, and not what waits in its journal.
    """
    if path.is_file():
        return [path]
    if (path / "metadata.yaml").is_file() and not any(map(journal_of, path.glob("*.db3"))):
        return [path]
    return sorted((file for file in path.iterdir() if bag_suffix(file)), key=natural)


def natural(path: Path) -> list[tuple[int, str]]:
    """An order in which bag_10 comes after bag_9."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


@contextmanager
def _opened(path: Path, given: Path) -> Iterator[Bag]:
    """Open a bag at ``path``, which may be a copy of the one that was ``given``."""
    if path.is_file() and not path.stat().st_size:
        raise LogError(f"{given}: is empty (0 bytes); was the recording stopped properly?")
    reader: Any
    try:
        reader = Reader1(path) if path.is_file() and path.suffix.lower() == ".bag" else Reader2(path)
        reader.open()
    except Exception as error:  # whatever a damaged or foreign file makes a parser raise
        reader = _foreign(path, given, error)
    try:
        yield reader
    finally:
        reader.close()


def _foreign(path: Path, given: Path, error: Exception) -> Any:
    """The reader of an MCAP file that is sound but no plain ROS 2 recording."""
    sound = path.is_file() and path.suffix.lower() == ".mcap" and _mcap_fault(path) is None
    if not sound:
        raise _explain(path, given, error) from error
    from legtool.datasets.logs.mcapfile import McapFile

    try:
        return McapFile(path)
    except Exception as other:
        raise _explain(path, given, other) from other


def is_ros1(connection: Connection) -> bool:
    """Whether a topic's messages have ROS 1 serialisation."""
    return getattr(connection.ext, "serialization_format", "ros1") == "ros1"


def is_json(connection: Connection) -> bool:
    """Whether a topic's messages are JSON text."""
    return getattr(connection.ext, "serialization_format", "") == "json"


def check_encoding(connection: Connection, path: Path) -> None:
    """Refuse a topic whose messages are neither ROS messages nor JSON.

    Raises:
        LogError: the message names the encoding, and what to do.
    """
    encoding = getattr(connection.ext, "serialization_format", "ros1")
    if encoding not in ("cdr", "ros1", "json", ""):
        how = ""
        if encoding == "protobuf":
            how = "decode them in Python with mcap-protobuf-support (mcap_protobuf.reader.read_protobuf_messages), and "
        raise LogError(
            f"{path}: topic {connection.topic} holds messages in {encoding}, which legtool does not read; {how}write "
            "their values as CSV or Parquet (--topics with csv), or record the topic in ROS"
        )


def guarded(path: Path, messages: Generator[T, None, None]) -> Iterator[T]:
    """Yield messages, and report any exception that reading them raises as damage of the file.

    Raises:
        LogError: the file is damaged; the message says how many messages could be read before.
    """
    count = 0
    while True:
        try:
            message = next(messages)
        except StopIteration:
            return
        except Exception as error:
            raise LogError(f"{path}: damaged after {count} of the messages that are read: {_line(error)}") from error
        count += 1
        yield message


def blocks(path: Path, messages: Generator[T, None, None]) -> Iterator[list[T]]:
    """Yield messages as :func:`guarded` does, some dozens at a time, which takes less time for each of them.

    Raises:
        LogError: as there.
    """
    count = 0
    while True:
        block: list[T] = []
        try:
            block.extend(itertools.islice(messages, _BLOCK))
        except Exception as error:
            count += len(block)
            raise LogError(f"{path}: damaged after {count} of the messages that are read: {_line(error)}") from error
        if not block:
            return
        count += len(block)
        yield block


def describe_bag(path: Path) -> dict[str, Any]:
    """Return ``duration_s``, ``start_ns``, ``messages`` and ``topics`` (name: ``type`` and ``messages``) of a bag.

    Raises:
        LogError: the bag is empty, truncated or damaged.
    """
    with opened(path) as reader:
        topics: dict[str, dict[str, Any]] = {}
        for connection in sorted(reader.connections, key=lambda c: c.topic):
            entry = topics.setdefault(connection.topic, {"type": connection.msgtype, "messages": 0})
            entry["messages"] += connection.msgcount
        count = reader.message_count
        return {
            "duration_s": reader.duration / 1e9 if count else 0.0,
            "start_ns": reader.start_time if count else 0,
            "messages": count,
            "topics": topics,
        }


def definitions(connections: Sequence[Connection], custom: Path | None, path: Path) -> dict[str, Any]:
    """Return message definitions as rosbags parses them: from the bag, else from the user, else the standard ones.

    Args:
        connections: the ones that are read; definitions of other topics are ignored.
        custom: directory of ``.msg`` files: ``PACKAGE/msg/NAME.msg``, or ``PACKAGE/NAME.msg``.
        path: path of the bag, for error messages.

    Raises:
        LogError: a definition cannot be parsed, or a type has none.
    """
    types: dict[str, Any] = dict(get_typestore(Stores.LATEST).fielddefs)
    connections = [connection for connection in connections if not is_json(connection)]
    for package in {connection.msgtype.partition("/")[0] for connection in connections}:
        if (shipped := _SHIPPED / package).is_dir():
            types.update(_custom(shipped))
    given = _custom(custom) if custom is not None else {}
    for connection in connections:
        check_encoding(connection, path)
        try:
            types.update(_defined(connection))
        except Exception as error:  # the parser of IDL raises what it pleases
            if connection.msgtype not in given:
                raise LogError(
                    f"{path}: the definition of {connection.msgtype} cannot be read: {_line(error)}; give its .msg "
                    "files with --msgs DIR"
                ) from error
    types.update(given)
    for connection in connections:
        if connection.msgtype not in types:
            raise LogError(
                f"{path}: topic {connection.topic} holds {connection.msgtype}, whose definition is not in the bag; "
                "give its .msg files with --msgs DIR"
            )
    return types


def _defined(connection: Connection) -> dict[str, Any]:
    """The types that a connection brings along."""
    text, kind = connection.msgdef.data, connection.msgdef.format
    if not text.strip():
        return {}
    if kind == MessageDefinitionFormat.MSG:
        return get_types_from_msg(text, connection.msgtype)
    types: dict[str, Any] = {}
    if kind == MessageDefinitionFormat.IDL:
        parts = text.split(_IDL_SEPARATOR)[1:] if text.startswith(f"{_IDL_SEPARATOR}IDL: ") else [f"\n{text}"]
        for part in parts:
            lines = [line for line in part.split("\n")[1:] if not line.lstrip().startswith(("#", "//"))]
            types.update(get_types_from_idl("\n".join(lines)))
    return types


def _custom(directory: Path) -> dict[str, Any]:
    files = sorted(directory.rglob("*.msg"))
    if not files:
        raise LogError(f"{directory}: holds no .msg files; expected PACKAGE/msg/NAME.msg")
    out: dict[str, Any] = {}
    for file in files:
        folder = file.resolve().parent
        package = folder.parent.name if folder.name == "msg" else folder.name
        try:
            out.update(get_types_from_msg(file.read_text(encoding="utf-8"), f"{package}/msg/{file.stem}"))
        except (TypesysError, UnicodeDecodeError) as error:
            raise LogError(f"{file}: not a message definition: {_line(error)}") from error
    return out


def _explain(path: Path, given: Path, error: Exception) -> LogError:
    for file in [path] if path.is_file() else sorted(path.glob("*.mcap")):
        if file.suffix.lower() == ".mcap" and (fault := _mcap_fault(file)):
            return LogError(f"{given if path.is_file() else file}: {fault}")
    return LogError(f"{given}: cannot be opened; it is damaged or not a bag: {_line(error)}")


def _mcap_fault(path: Path) -> str | None:
    """What is wrong with the ends of an MCAP file."""
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            return "is not an MCAP file (it does not start like one); check how it was copied"
        file.seek(-len(_MAGIC), 2)
        if file.read() == _MAGIC and file.tell() > len(_MAGIC):
            return None
    return (
        f"is truncated (the end of the file is missing): {_readable(path)} messages are readable; save them with "
        f"'mcap recover {path.name} -o {path.stem}_recovered.mcap' and read that"
    )


def _readable(path: Path) -> int:
    """How many messages stand before the break."""
    from mcap.records import Message
    from mcap.stream_reader import StreamReader

    count = 0
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                count += isinstance(record, Message)
        except Exception:  # the break: whatever it makes the parser raise
            return count
    return count


def _line(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 200 else text[:197] + "..."
