"""A plain writer of small ONNX models, so that tests need no onnx: protobuf messages of the fields that are used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

FLOAT, UINT8, INT64 = 1, 2, 7
_TYPES = {np.dtype(np.float32): FLOAT, np.dtype(np.uint8): UINT8, np.dtype(np.int64): INT64}


def _varint(value: int) -> bytes:
    value &= (1 << 64) - 1
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def _field(number: int, value: Any) -> bytes:
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    content = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | 2) + _varint(len(content)) + content


def node(operator: str, inputs: Sequence[str], output: str, **attributes: int | Sequence[int]) -> bytes:
    """One operator; attributes are whole numbers or lists of them."""
    out = b"".join(_field(1, name) for name in inputs) + _field(2, output) + _field(4, operator)
    for name, value in attributes.items():
        numbers = [value] if isinstance(value, int) else value
        kind, field = (2, 3) if isinstance(value, int) else (7, 8)
        out += _field(5, _field(1, name) + b"".join(_field(field, n) for n in numbers) + _field(20, kind))
    return out


def model(
    nodes: Sequence[bytes],
    inputs: Mapping[str, Sequence[int | str]],
    outputs: Mapping[str, tuple[int, Sequence[int | str]]],
    constants: Mapping[str, np.ndarray] | None = None,
) -> bytes:
    """A model of float32 inputs: name to shape, a size's name where any will do; outputs: name to type and shape."""
    graph = b"".join(_field(1, n) for n in nodes) + _field(2, "g")
    for name, value in (constants or {}).items():
        dims = b"".join(_field(1, n) for n in value.shape)
        graph += _field(5, dims + _field(2, _TYPES[value.dtype]) + _field(8, name) + _field(9, value.tobytes()))
    graph += b"".join(_field(11, _port(name, FLOAT, shape)) for name, shape in inputs.items())
    graph += b"".join(_field(12, _port(name, kind, shape)) for name, (kind, shape) in outputs.items())
    return _field(1, 8) + _field(7, graph) + _field(8, _field(1, "") + _field(2, 13))


def _port(name: str, kind: int, shape: Sequence[int | str]) -> bytes:
    dims = b"".join(_field(1, _field(1 if isinstance(n, int) else 2, n)) for n in shape)
    return _field(1, name) + _field(2, _field(1, _field(1, kind) + _field(2, dims)))
