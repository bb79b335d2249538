"""Decode many serialised ROS messages at once.

The messages of one topic nearly always share one layout: equal lengths of all strings and sequences put each number
at the same byte. The first message is parsed by the definition of its type, the others are checked against the length
words found there, and numbers are then taken from all messages as columns of one byte matrix.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from legtool.datasets.logs.signals import Array
from legtool.errors import LogError

Bytes = NDArray[np.uint8]
_DTYPES = {
    "bool": "u1", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
#: Bytes of the CDR encapsulation header; alignment is counted from the end of it.
_ENCAPSULATION = 4
#: How data that zstd has compressed begins.
_ZSTD = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True)
class Leaf:
    """Consecutive numbers of one type."""

    offset: int
    dtype: np.dtype[Any]
    count: int


@dataclass
class Layout:
    """Where each field is in messages of one size.

    Attributes:
        leaves: numbers, by dotted path, in the order of the definition.
        strings: (offset, length) of each string's text, by dotted path.
        names: texts that are part of the layout, by dotted path: those of members called name, such as joints' names.
        empty: dotted paths of sequences that hold nothing in these messages.
        pinned: byte ranges that must agree for a message to have this layout.
    """

    leaves: dict[str, Leaf] = field(default_factory=dict)
    strings: dict[str, tuple[int, int]] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    empty: set[str] = field(default_factory=set)
    pinned: list[tuple[int, int]] = field(default_factory=list)

    def find(self, path: str) -> list[str]:
        """Return the leaves at or below a dotted path.

        A part of the path may be a name or index, a pattern (``*``, ``foot_*``), a range of indices (``0-11``), or the
        name of an element, if the names are listed beside (``pose.robot.position``, with ``name: [ground, robot]``).
        """
        parts = self._resolve(path.split("."))
        return [
            name
            for name in self.leaves
            if len(have := name.split(".")) >= len(parts)
            and all(_matches(want, part) for want, part in zip(parts, have, strict=False))
        ]

    def _resolve(self, parts: list[str]) -> list[str]:
        """The path with elements' names turned into their indices."""
        listed = {
            text: place.rsplit(".", 2) for place, text in self.names.items() if place.rsplit(".", 1)[-1].isdigit()
        }
        out: list[str] = []
        for number, part in enumerate(parts):
            place = listed.get(part)
            beside = ".".join(out[:-1]) if out else None
            if number and place is not None and ".".join(place[:-2]) == beside:
                part = place[-1]
            out.append(part)
        return out

    def name_at(self, path: str) -> str | None:
        """The name of the element in which a leaf lies, if names are listed beside."""
        parts = path.split(".")
        for number, part in enumerate(parts):
            if part.isdigit() and number:
                beside = [*parts[: number - 1], "name", part]
                if (name := self.names.get(".".join(beside))) is not None:
                    return name
        return None

    def take(self, messages: Bytes, path: str) -> NDArray[Any]:
        """Return the numbers (n, count) of one leaf, from messages (n, size)."""
        leaf = self.leaves[path]
        end = leaf.offset + leaf.count * leaf.dtype.itemsize
        return np.ascontiguousarray(messages[:, leaf.offset : end]).view(leaf.dtype)

    def values(self, messages: Bytes, paths: Sequence[str]) -> Array:
        """Return the numbers (n, k) of several leaves side by side."""
        return np.concatenate([self.take(messages, path).astype(np.float64) for path in paths], axis=1)

    def text(self, message: Bytes, path: str) -> str:
        """Return one string of a message."""
        offset, length = self.strings[path]
        return message[offset : offset + length].tobytes().decode("utf-8", "replace")


def groups(
    raws: Sequence[bytes | memoryview], types: Mapping[str, Any], name: str, *, ros1: bool
) -> Iterator[tuple[NDArray[np.intp], Layout, Bytes]]:
    """Yield messages of one type in groups that share a layout.

    Args:
        raws: serialised messages.
        types: definitions by type name, as rosbags parses them.
        name: the messages' type.
        ros1: whether the messages use ROS 1 serialisation instead of CDR.

    Yields:
        indices into ``raws``, their layout, and their bytes (n, size).

    Raises:
        LogError: a message does not fit the definition of its type.
    """
    sizes = np.fromiter(map(len, raws), dtype=np.intp, count=len(raws))
    for size in np.unique(sizes):
        index = np.flatnonzero(sizes == size)
        chosen = raws if len(index) == len(raws) else [raws[i] for i in index.tolist()]
        matrix = np.frombuffer(b"".join(chosen), dtype=np.uint8).reshape(len(index), int(size))
        while len(index):
            layout = walk(matrix[0].tobytes(), types, name, ros1=ros1)
            same = np.ones(len(index), dtype=np.bool_)
            for start, end in layout.pinned:
                same &= (matrix[:, start:end] == matrix[0, start:end]).all(axis=1)
            if same.all():
                yield index, layout, matrix
                break
            yield index[same], layout, matrix[same]
            index, matrix = index[~same], matrix[~same]


def walk(raw: bytes, types: Mapping[str, Any], name: str, *, ros1: bool) -> Layout:
    """Return the layout of one message.

    Raises:
        LogError: the message does not fit the definition, or the definition is unknown.
    """
    walker = _Walker(raw, types, ros1=ros1)
    try:
        walker.message(name, "")
    except (struct.error, IndexError) as error:
        raise LogError(f"a message of type {name} is shorter than its definition says; the log is damaged") from error
    if walker.position > len(raw) or walker.position + 3 < len(raw):
        raise LogError(
            f"a message of type {name} has {len(raw)} bytes, its definition describes {walker.position}; "
            "the log is damaged or holds another version's messages"
        )
    return walker.layout


def _matches(want: str, part: str) -> bool:
    if want == part or want == "*":
        return True
    first, dash, last = want.partition("-")
    if dash and first.isdigit() and last.isdigit():
        return part.isdigit() and int(first) <= int(part) <= int(last)
    return "*" in want and fnmatchcase(part, want)


class _Walker:
    def __init__(self, raw: bytes, types: Mapping[str, Any], *, ros1: bool) -> None:
        self.raw, self.types, self.ros1 = raw, types, ros1
        self.position, self.order = 0, "<"
        self.layout = Layout()
        if not ros1:
            if raw[:4] == _ZSTD:
                raise LogError("messages are compressed one by one (zstd); give the bag's directory, which says so")
            if raw[:2] not in (b"\x00\x00", b"\x00\x01"):
                raise LogError(f"a message is encoded as {raw[:2].hex()}, expected plain CDR (0000 or 0001)")
            self.order = "<" if raw[1] else ">"
            self.position = _ENCAPSULATION
            self.layout.pinned.append((0, 2))

    def message(self, name: str, path: str) -> None:
        if name not in self.types:
            raise LogError(f"message type {name} has no definition in the log; give its .msg files with --msgs DIR")
        for member, description in self.types[name][1]:
            self.member(description, f"{path}.{member}" if path else member)

    def member(self, description: Any, path: str) -> None:
        kind, detail = description
        if kind == Nodetype.NAME:
            self.message(detail, path)
        elif kind == Nodetype.BASE:
            self.base(detail[0], 1, path)
        else:
            inner, count = detail
            if kind == Nodetype.SEQUENCE:
                count = self.length()
                if not count:
                    self.layout.empty.add(path)
            if inner[0] == Nodetype.BASE and inner[1][0] != "string":
                self.base(inner[1][0], count, path)
                return
            if count > len(self.raw):
                raise IndexError(path)
            for index in range(count):
                self.member(inner, f"{path}.{index}")

    def base(self, kind: str, count: int, path: str) -> None:
        if kind == "string":
            length = self.length()
            start = self.position
            self.position += length
            if self.position > len(self.raw):
                raise IndexError(path)
            size = length if self.ros1 else max(length - 1, 0)
            self.layout.strings[path] = (start, size)
            if "name" in path.split("."):
                self.layout.pinned.append((start, self.position))
                self.layout.names[path] = self.raw[start : start + size].decode("utf-8", "replace")
            return
        if kind not in _DTYPES:
            raise LogError(f"field {path} has type {kind}, which legtool cannot decode; choose other topics")
        dtype = np.dtype(self.order + _DTYPES[kind])
        if count:
            self.align(dtype.itemsize)
        if path:
            self.layout.leaves[path] = Leaf(self.position, dtype, count)
        self.position += count * dtype.itemsize
        if self.position > len(self.raw):
            raise IndexError(path)

    def length(self) -> int:
        self.align(4)
        (value,) = struct.unpack_from(f"{self.order}I", self.raw, self.position)
        self.layout.pinned.append((self.position, self.position + 4))
        self.position += 4
        return int(value)

    def align(self, size: int) -> None:
        if not self.ros1:
            self.position += -(self.position - _ENCAPSULATION) % size
