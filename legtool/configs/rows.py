"""Names of a suite's planners: those that are built in, classes of the user's, and either with some settings changed.

``quadpips[regions=truth]`` is the planner quadpips with one setting changed for this row alone, and
``quadpips[pips.walkability.margin_m=0;pips.candidates.least_margin=0]`` with two: an ablation is a row like any other.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple

from legtool.configs.yaml_text import parse_yaml
from legtool.errors import LegtoolError, SettingsError
from legtool_runtime.errors import shown

#: Settings that all rows of a suite share: they say which trials there are, where they begin, and who walks.
SHARED = (
    "suite", "planners", "trials", "horizons", "seed", "films", "robot", "mjcf", "mjcf_names", "camera", "camera_size",
    "members", "start_x", "start_y", "start_heading", "noise", "timeout_s", "deadline_s", "mass_error", "push_speed",
    "records", "record_images",
)  # fmt: skip
_CHANGED = re.compile(r"(?P<planner>[^\[\]]+)\[(?P<changes>[^\[\]]+)\]")
#: Commas that part planners: those outside of brackets.
_BETWEEN = re.compile(r",(?![^\[\]]*\])")


class Row(NamedTuple):
    """A planner by its name, and the settings that are changed for it: dotted names to values."""

    planner: str
    changes: dict[str, Any]


def split_planners(text: str) -> list[str]:
    """Names of planners with commas between them."""
    return [part.strip() for part in _BETWEEN.split(text)]


def parse_row(name: str) -> Row:
    """What a name means.

    Raises:
        ValueError: brackets without ``key=value``, a setting that all rows share, or a value that is not YAML.
    """
    if "[" not in name and "]" not in name:
        return Row(name, {})
    found = _CHANGED.fullmatch(name)
    if found is None:
        raise ValueError(f"planner {name!r}: expected a name, or name[key=value;key=value]")
    changes: dict[str, Any] = {}
    for item in found["changes"].split(";"):
        key, separator, text = (part.strip() for part in item.partition("="))
        if not separator or not key:
            raise ValueError(f"planner {name!r}: expected key=value in its brackets, got {item!r}")
        if key.partition(".")[0] in SHARED:
            raise ValueError(f"planner {name!r}: {key} is a setting of the whole suite; set it by --set {item.strip()}")
        try:
            changes[key] = parse_yaml(text)
        except ValueError as error:
            raise ValueError(f"planner {shown(name)}: the value of {key} is {error}") from error
    return Row(found["planner"], changes)


def is_class(planner: str) -> bool:
    """Whether a planner is a class of the user's, ``module:Class``."""
    return ":" in planner


def is_horizon(planner: str) -> bool:
    """Whether a planner is that of velocity commands at a horizon, ``h5``."""
    return planner[:1] == "h" and planner[1:].isdecimal()


def changed(values: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Plain settings with some of them changed; dots reach into groups."""
    out = dict(values)
    for key, value in changes.items():
        first, _, rest = key.partition(".")
        inner = out.get(first)
        out[first] = changed(inner if isinstance(inner, dict) else {}, {rest: value}) if rest else value
    return out


def dataclass_with(settings: Any, changes: Mapping[str, Any], name: str) -> Any:
    """Settings of the runtime with some of them changed by name, groups by mappings.

    Args:
        settings: an instance of a dataclass, which may nest.
        changes: names to values, or to the changes of a group; lists stand for tuples.
        name: of the whole, for messages.

    Raises:
        SettingsError: no such setting, or a value that is out of range.
    """
    known = {field.name for field in fields(settings)}
    values: dict[str, Any] = {}
    for key, value in changes.items():
        if key not in known:
            raise SettingsError(f"unknown setting {f'{name}.{key}'!r}; expected one of: {', '.join(sorted(known))}")
        group = getattr(settings, key)
        if is_dataclass(group) and isinstance(value, Mapping):
            values[key] = dataclass_with(group, value, f"{name}.{key}")
        else:
            values[key] = tuple(value) if isinstance(value, list) else value
    try:
        return replace(settings, **values)
    except (LegtoolError, TypeError) as error:
        raise SettingsError(f"{name}: {error}") from error
