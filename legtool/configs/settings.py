"""Typed settings: one frozen model per command, that knows its own defaults and bounds.

A setting comes from (later wins) its default, ``--config FILE``, ``--set key=value``, and the named options. What a
command wrote serves as a file of the settings that it was written with.

Settings nest. A group is another model, or a settings dataclass of the runtime as it is: ``planner: PlannerSettings =
PlannerSettings()`` is set by ``--set planner.margin_m=0.02``, takes names, types, defaults and descriptions from that
class, and is handed to the runtime as ``settings.planner``. The dataclass checks its own bounds.
"""

from __future__ import annotations

import inspect
import json
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from legtool.configs.yaml_text import parse_yaml
from legtool.errors import LegtoolError, SettingsError
from legtool_runtime.errors import one_line, shown

T = TypeVar("T", bound="Settings")
#: Files that a command writes, and where in them its settings are.
_HOLDERS = {"manifest.json": ("settings",), "run.json": ("settings",), "results.json": ("provenance", "settings")}


class Settings(BaseModel):
    """Base of all settings: frozen, unknown keys refused, values checked when built.

    Attributes:
        renamed: names that are refused, dots reaching into groups, and the setting to use instead: old names, and
            members of a nested dataclass that are given elsewhere. The latter are neither accepted nor shown.
        code: names of settings that may name a Python class (``module:Class``), which is imported and run.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    renamed: ClassVar[dict[str, str]] = {}
    code: ClassVar[tuple[str, ...]] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, all keys present."""
        values = self.model_dump(mode="json")
        for name in self.renamed:
            group, last = _group_of(values, name)
            group.pop(last, None)
        return values

    def to_yaml(self) -> str:
        """The full settings as YAML, comments taken from the descriptions of the fields."""
        return "\n".join(_yaml_lines(self, self.to_dict(), "")) + "\n"

    def replace(self, **changes: Any) -> Self:
        """A copy with some values changed, checked like any other."""
        return build(type(self), {**self.to_dict(), **changes})


def build(cls: type[T], values: Mapping[str, Any], *, source: str = "settings") -> T:
    """Build settings from plain values.

    Raises:
        SettingsError: one line that names the first wrong key, what was given and what was expected.
    """
    for old, new in cls.renamed.items():
        group, last = _group_of(values, old)
        if last in group:
            raise SettingsError(f"{source}: setting {old!r} is now {new!r}")
    defaults = {name: field.get_default(call_default_factory=True) for name, field in cls.model_fields.items()}
    try:
        return cls.model_validate({name: _onto(defaults.get(name), value) for name, value in values.items()})
    except ValidationError as error:
        raise SettingsError(f"{source}: {_explain(cls, error)}") from error
    except LegtoolError as error:  # a nested dataclass of the runtime checked its own bounds
        raise SettingsError(f"{source}: {error}") from error


def load(
    cls: type[T],
    config: Path | None = None,
    overrides: Sequence[str] = (),
    *,
    allow_code: bool = False,
    **named: Any,
) -> T:
    """Settings from a YAML file, or from what a command wrote, ``key=value`` overrides (dots reach into groups) and
    named options.

    Named options that are ``None`` were not given, and leave the setting as it is. A file may come from a stranger: the
    classes that it names are imported only with ``allow_code``; those of the command line are the user's own.

    Raises:
        SettingsError: unreadable file, unknown key, value out of range, an override without ``=``, a file that names a
            class without ``allow_code``, or a directory that holds no settings, or none of this command.
    """
    values = {} if config is None else _settings_of(config)
    if not allow_code:
        for name in cls.code:
            held = values.get(name)
            parts = held if isinstance(held, list) else [held]
            if found := next((part for part in parts if isinstance(part, str) and _names_code(part)), None):
                raise SettingsError(
                    f"{config}: {name} names Python code, {shown(found)}, which would be imported and run; if you "
                    "trust it, add --allow-code"
                )
    contents = {name for name, value in values.items() if _is_content(cls, name, value)}
    values = {name: value for name, value in values.items() if name not in contents}
    for item in overrides:
        key, separator, text = item.partition("=")
        if not separator or not key:
            raise SettingsError(f"--set {one_line(item)}: expected key=value, such as --set seed=3")
        try:
            value = parse_yaml(text)
        except ValueError as error:
            raise SettingsError(f"--set {one_line(item)}: the value is {error}") from error
        target = values
        *parents, last = key.strip().split(".")
        for parent in parents:
            inner = target.setdefault(parent, {})
            if not isinstance(inner, dict):
                raise SettingsError(f"--set {item}: {parent} is a value, not a group of settings")
            target = inner
        target[last] = value
    values.update({name: value for name, value in named.items() if value is not None})
    if lacking := sorted(contents - values.keys()):
        raise SettingsError(f"{config}: holds the content of {lacking[0]}, and not its name; give --{lacking[0]} again")
    source = "settings" if config is None else str(config)
    return build(cls, values, source=source)


def _settings_of(config: Path) -> dict[str, Any]:
    """Plain values of a YAML file, or of a dataset, run or results."""
    held: Any
    if config.is_dir():
        found = next((config / name for name in _HOLDERS if (config / name).is_file()), None)
        if found is None:
            raise SettingsError(
                f"{config}: holds none of {', '.join(_HOLDERS)}; expected what a command wrote, or a file"
            )
        try:
            held = json.loads(found.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise SettingsError(f"{found}: not readable as JSON ({shown(error)})") from error
        for key in _HOLDERS[found.name]:
            held = held.get(key) if isinstance(held, dict) else None
    else:
        held = read_yaml(config)
    if not isinstance(held, dict):
        raise SettingsError(f"{config}: expected a mapping of settings, got {type(held).__name__}")
    return held


def _is_content(cls: type[Settings], name: str, value: Any) -> bool:
    """Whether a dataset holds the content of files where the setting names them."""
    field = cls.model_fields.get(name)
    parts = value if isinstance(value, list) else [value]
    named = field is not None and field.annotation in (str, tuple[str, ...])
    return named and any(isinstance(part, Mapping) for part in parts)


def read_yaml(path: Path) -> Any:
    """Parse one YAML file with the safe loader.

    Raises:
        SettingsError: the file is missing, not text, or not YAML.
    """
    try:
        return parse_yaml(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise SettingsError(f"{path}: no such file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: cannot be read as text ({error})") from error
    except ValueError as error:
        raise SettingsError(f"{path}: {error}") from error


def _onto(default: Any, given: Any) -> Any:
    """Values for a nested dataclass, completed by its default instance, which may differ from the class's defaults."""
    if not (is_dataclass(default) and isinstance(given, Mapping)):
        return given
    held = {field.name: getattr(default, field.name) for field in fields(default)}
    return {**held, **{name: _onto(held.get(name), value) for name, value in given.items()}}


def _group_of(values: Mapping[str, Any], name: str) -> tuple[Any, str]:
    """The mapping in which a dotted name would stand, empty where there is none, and the last part of the name."""
    *parents, last = name.split(".")
    group: Any = values
    for parent in parents:
        group = group.get(parent) if isinstance(group, Mapping) else None
    return group if isinstance(group, Mapping) else {}, last


def _explain(cls: type[Settings], error: ValidationError) -> str:
    first = error.errors()[0]
    missing = [".".join(map(str, entry["loc"])) for entry in error.errors() if entry["type"] == "missing"]
    path = one_line(".".join(str(part) for part in first["loc"]))
    if first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        names = _names_in(cls, first["loc"][:-1])
        prefix = path.rpartition(".")[0]
        known = {name for name in names if f"{prefix}.{name}" not in cls.renamed}
        return f"unknown setting {path!r}; expected one of: {', '.join(sorted(known)) or 'none'}"
    if first["type"] == "missing":
        return f"settings are missing: {', '.join(missing)}" if len(missing) > 1 else f"setting {path!r} is missing"
    more = f"; missing besides: {', '.join(missing)}" if missing else ""
    message = first["msg"].removeprefix("Value error, ").removeprefix("Input ")
    given = "" if isinstance(first["input"], dict) else f" is {shown(first['input'])};"
    return f"setting {path!r}{given} {message}{more}" if path else message


def _names_code(value: str) -> bool:
    """Whether a value names a class: by itself, in a list with commas, or in the brackets of a row of a suite."""
    return ":" in value and not value.endswith((".yaml", ".yml"))


def _names_in(cls: type[BaseModel], location: Sequence[int | str]) -> list[str]:
    """Names of the settings in the group at ``location``."""
    group: Any = cls
    for part in location:
        field = getattr(group, "model_fields", {}).get(part)
        given = field.annotation if field is not None else None
        # An optional group is a union: the group is one of its arms.
        arms = (given, *get_args(given))
        group = next((arm for arm in arms if hasattr(arm, "model_fields") or is_dataclass(arm)), None)
    if is_dataclass(group):
        return [field.name for field in fields(group)]
    return list(getattr(group, "model_fields", {}))


def _yaml_lines(group: Any, plain: Mapping[str, Any], indent: str) -> Iterator[str]:
    told = descriptions(type(group))
    for name, value in plain.items():
        member = getattr(group, name)
        for line in textwrap.wrap(told.get(name) or "", 118 - len(indent)):
            yield f"{indent}# {line}"
        if isinstance(member, BaseModel) or is_dataclass(member):
            yield f"{indent}{name}:"
            yield from _yaml_lines(member, value, indent + "  ")
        else:
            text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10**9)
            yield f"{indent}{name}: {text.removesuffix('...' + chr(10)).rstrip()}"


def descriptions(cls: type) -> dict[str, str]:
    """What each setting of a group means: from a model's fields, or from the Attributes of a dataclass's docstring."""
    if issubclass(cls, BaseModel):
        return {name: field.description or "" for name, field in cls.model_fields.items()}
    _, _, section = inspect.cleandoc(cls.__doc__ or "").partition("\nAttributes:\n")
    section = section.partition("\n\n")[0]
    # An entry begins four spaces in; what is further in carries it on.
    entries = re.findall(r"^ {4}(\w+): (.*(?:\n {5,}.*)*)", section, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}
