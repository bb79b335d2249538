"""Decode messages of JSON text into the form that serialised ROS messages have, so that all else is the same."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool.datasets.logs.layout import Bytes, Layout, Leaf
from legtool.errors import LogError

_NUMBER = np.dtype("<f8")
#: The order of components, whatever their order in the text.
_COMPONENTS = "xyzw"


def json_groups(raws: Sequence[bytes | memoryview]) -> Iterator[tuple[NDArray[np.intp], Layout, Bytes]]:
    """Yield messages in groups that have the same fields, as :func:`.layout.groups` does.

    Numbers and truth values become float64, null is not a number; lists of numbers are one field, elements of other
    lists have their index in the path. Texts below a member called name are names of elements; others are left out.

    Raises:
        LogError: a message is no JSON object.
    """
    held: dict[tuple[Any, ...], list[tuple[int, list[float]]]] = {}
    for number, raw in enumerate(raws):
        try:
            message = json.loads(bytes(raw))
        except ValueError as error:
            raise LogError(f"a message is no JSON text: {error}") from error
        if not isinstance(message, dict):
            raise LogError(f"a message is JSON, but no object: {str(message)[:40]}")
        shape: list[tuple[str, int]] = []
        names: list[tuple[str, str]] = []
        values: list[float] = []
        _flatten(message, "", shape, names, values)
        held.setdefault((tuple(shape), tuple(names)), []).append((number, values))
    for (shape, names), rows in held.items():
        index = np.array([number for number, _ in rows], dtype=np.intp)
        table = np.array([values for _, values in rows], dtype=_NUMBER).reshape(len(rows), -1)
        matrix = np.ascontiguousarray(table).view(np.uint8).reshape(len(rows), 8 * table.shape[1])
        yield index, _layout(shape, names), matrix


def _layout(shape: Sequence[tuple[str, int]], names: Sequence[tuple[str, str]]) -> Layout:
    layout, offset = Layout(names=dict(names)), 0
    for path, count in shape:
        if count:
            layout.leaves[path] = Leaf(offset, _NUMBER, count)
        else:
            layout.empty.add(path)
        offset += count * _NUMBER.itemsize
    if (short := layout.leaves.get("header.stamp.nsec")) is not None:
        layout.leaves["header.stamp.nanosec"] = short
    return layout


def _flatten(
    item: Any, path: str, shape: list[tuple[str, int]], names: list[tuple[str, str]], values: list[float]
) -> None:
    if isinstance(item, Mapping):
        keys = sorted(item, key=_COMPONENTS.index) if item.keys() <= set(_COMPONENTS) else list(item)
        for key in keys:
            _flatten(item[key], f"{path}.{key}" if path else str(key), shape, names, values)
    elif isinstance(item, list):
        if all(_is_number(one) for one in item):
            shape.append((path, len(item)))
            values += [_number(one) for one in item]
            return
        for index, one in enumerate(item):
            _flatten(one, f"{path}.{index}", shape, names, values)
    elif _is_number(item):
        shape.append((path, 1))
        values.append(_number(item))
    elif isinstance(item, str) and "name" in path.split("."):
        names.append((path, item))


def _is_number(item: Any) -> bool:
    return item is None or isinstance(item, (bool, int, float))


def _number(item: float | None) -> float:
    return float("nan") if item is None else float(item)
