"""Open bag files, describe their contents, and explain what is wrong with a damaged one."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore

from legtool.errors import LogError

T = TypeVar("T")
_IDL_SEPARATOR = "=" * 80 + "\n"
_MAGIC = b"\x89MCAP0\r\n"


@contextmanager
def opened(path: Path) -> Iterator[Reader1 | Reader2]:
    """Open a bag and yield its reader.

    Raises:
        LogError: the bag is empty, truncated or damaged; the message says how much can be recovered.
    """
    if path.is_file() and not path.stat().st_size:
        raise LogError(f"{path}: is empty (0 bytes); was the recording stopped properly?")
    reader: Reader1 | Reader2
    try:
        reader = Reader1(path) if path.suffix.lower() == ".bag" else Reader2(path)
        reader.open()
    except Exception as error:  # whatever a damaged file makes a parser raise
        raise _explain(path, error) from error
    try:
        yield reader
    finally:
        reader.close()


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
    if custom is not None:
        types.update(_custom(custom))
    for connection in connections:
        text, kind = connection.msgdef.data, connection.msgdef.format
        try:
            if kind == MessageDefinitionFormat.MSG:
                types.update(get_types_from_msg(text, connection.msgtype))
            elif kind == MessageDefinitionFormat.IDL:
                parts = text.split(_IDL_SEPARATOR)[1:] if text.startswith(f"{_IDL_SEPARATOR}IDL: ") else [f"\n{text}"]
                for part in parts:
                    types.update(get_types_from_idl(part.split("\n", 1)[1]))
        except TypesysError as error:
            raise LogError(f"{path}: the definition of {connection.msgtype} cannot be read: {_line(error)}") from error
        if connection.msgtype not in types:
            raise LogError(
                f"{path}: topic {connection.topic} holds {connection.msgtype}, whose definition is not in the bag; "
                "give its .msg files with --msgs DIR"
            )
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


def _explain(path: Path, error: Exception) -> LogError:
    for file in [path] if path.is_file() else sorted(path.glob("*.mcap")):
        if file.suffix.lower() == ".mcap" and (fault := _mcap_fault(file)):
            return LogError(f"{file}: {fault}")
    return LogError(f"{path}: cannot be opened; it is damaged or not a bag: {_line(error)}")


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
