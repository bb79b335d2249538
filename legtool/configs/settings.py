"""Typed settings: one frozen model per command, that knows its own defaults and bounds.

A setting comes from (later wins) its default, ``--config FILE``, ``--set key=value``, and the named options.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from legtool.errors import SettingsError

T = TypeVar("T", bound="Settings")


class Settings(BaseModel):
    """Base of all settings: frozen, unknown keys refused, values checked when built."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, all keys present."""
        return self.model_dump(mode="json")

    def to_yaml(self) -> str:
        """The full settings as YAML, comments taken from the fields' descriptions."""
        lines: list[str] = []
        _yaml_lines(self, 0, lines)
        return "\n".join(lines) + "\n"

    def replace(self, **changes: Any) -> Self:
        """A copy with some values changed, checked like any other."""
        return build(type(self), {**self.to_dict(), **changes})


def build(cls: type[T], values: Mapping[str, Any], *, source: str = "settings") -> T:
    """Build settings from plain values.

    Raises:
        SettingsError: one line that names the first wrong key, what was given and what was expected.
    """
    try:
        return cls.model_validate(dict(values))
    except ValidationError as error:
        raise SettingsError(f"{source}: {_explain(cls, error)}") from error


def load(
    cls: type[T],
    config: Path | None = None,
    overrides: Sequence[str] = (),
    **named: Any,
) -> T:
    """Settings from a YAML file, ``key=value`` overrides (dots reach into nested settings) and named options.

    Named options that are ``None`` were not given, and leave the setting as it is.

    Raises:
        SettingsError: unreadable file, unknown key, value out of range, or an override without ``=``.
    """
    values: dict[str, Any] = {}
    if config is not None:
        loaded = read_yaml(config)
        if not isinstance(loaded, dict):
            raise SettingsError(f"{config}: expected a mapping of settings, got {type(loaded).__name__}")
        values = loaded
    for item in overrides:
        key, separator, text = item.partition("=")
        if not separator or not key:
            raise SettingsError(f"--set {item}: expected key=value, such as --set seed=3")
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise SettingsError(f"--set {item}: the value is not valid YAML") from error
        target = values
        *parents, last = key.strip().split(".")
        for parent in parents:
            inner = target.setdefault(parent, {})
            if not isinstance(inner, dict):
                raise SettingsError(f"--set {item}: {parent} is a value, not a group of settings")
            target = inner
        target[last] = value
    values.update({name: value for name, value in named.items() if value is not None})
    source = "settings" if config is None else str(config)
    return build(cls, values, source=source)


def read_yaml(path: Path) -> Any:
    """Parse one YAML file with the safe loader.

    Raises:
        SettingsError: the file is missing, not text, or not YAML.
    """
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise SettingsError(f"{path}: no such file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: cannot be read as text ({error})") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark else ""
        raise SettingsError(f"{path}: not valid YAML{where}") from error


def _explain(cls: type[BaseModel], error: ValidationError) -> str:
    first = error.errors()[0]
    path = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        model: Any = cls
        for part in first["loc"][:-1]:
            field = getattr(model, "model_fields", {}).get(part)
            given = field.annotation if field is not None else None
            # an optional group is a union: the model is one of its arms
            model = next((arm for arm in (given, *get_args(given)) if hasattr(arm, "model_fields")), None)
        known = ", ".join(sorted(getattr(model, "model_fields", {}))) or "none"
        return f"unknown setting {path!r}; expected one of: {known}"
    if first["type"] == "missing":
        return f"setting {path!r} is missing"
    message = first["msg"].removeprefix("Value error, ").removeprefix("Input ")
    given = "" if isinstance(first["input"], dict) else f" is {first['input']!r};"
    return f"setting {path!r}{given} {message}" if path else message


def _yaml_lines(model: BaseModel, depth: int, lines: list[str]) -> None:
    indent = "  " * depth
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        if field.description:
            lines.append(f"{indent}# {field.description}")
        if isinstance(value, BaseModel):
            lines.append(f"{indent}{name}:")
            _yaml_lines(value, depth + 1, lines)
        else:
            plain = model.model_dump(mode="json", include={name})[name]
            text = yaml.safe_dump(plain, default_flow_style=True, sort_keys=False, width=10**9)
            lines.append(f"{indent}{name}: {text.removesuffix('...' + chr(10)).rstrip()}")
