"""Pages of the site that are made from the code: commands, settings, and the API of both packages."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import types
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import annotated_types
import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import legtool
import legtool_runtime
from legtool.cli import COMMANDS, GROUPS
from legtool.command import Command, Option
from legtool.configs.settings import descriptions

#: Settings of no command's own: what YAML files hold, in the order of the page.
FILES = (
    ("Robots", "`--robot FILE`, and presets of `legtool/configs/robots`", "legtool.configs.robots:RobotSettings"),
    ("Topics", "`--topics FILE`, and presets of `legtool/configs/topics`", "legtool.configs.topics:TopicSettings"),
    ("Worlds", "`--suite FILE`, and presets of `legtool/configs/worlds`", "legtool.configs.worlds:WorldSettings"),
    ("Policies", "`--set black_box=FILE`", "legtool.configs.policies:PolicySettings"),
)
#: Commands with settings beside those that their help shows, and when these are taken.
OTHERS = (("eval vpa", "--suite vital", "legtool.configs.vital:VitalSettings"),)
#: How a default is written that fills no more than a cell of a table.
_LONGEST = 60


class Row(NamedTuple):
    """One setting: its key with dots into groups, type with bounds, default (None: it must be given), and meaning."""

    key: str
    type: str
    default: str | None
    meaning: str


def commands() -> str:
    """The page of the command line, as MyST Markdown."""
    out = [
        "# Commands\n",
        "This page is made from the table of commands that `legtool` itself is made from. `legtool COMMAND -h` prints "
        "the same. Every command also takes `--quiet` (print nothing but errors), `--debug` (show the traceback of an "
        "error) and `-h`; `legtool --version` shows the version, and `legtool --install-completion` makes the shell "
        "complete commands and presets.\n\n"
        "The exit code is 0 where the command did its work, 1 where `--check` was given and the verdict is red (or an "
        "error is a defect of legtool), 2 where what was given cannot be used (one line on standard error says what "
        "was expected), 3 where some parts failed again and again and all others are done, and 130 after Ctrl-C. "
        "Settings are on [a page of their own](settings.md).\n",
    ]
    group = None
    for command in sorted(COMMANDS, key=lambda one: (list(GROUPS).index(_group(one)), 0)):
        if _group(command) != group:
            group = _group(command)
            out.append(f"## {f'legtool {group}' if group else 'legtool'}\n\n{GROUPS[group]}\n")
        out.append(_command(command))
    return "\n".join(out)


def _group(command: Command) -> str:
    return " ".join(command.name.split()[:-1])


def _command(command: Command) -> str:
    usage = " ".join(
        ["legtool", command.name, *(_usage(one) for one in command.options if not one.name.startswith("-"))]
    )
    head = f"### {command.name}\n\n{command.help}\n\n```text\n{usage} [OPTIONS]\n```\n"
    rows = [(f"`{one.name}`", _kind(one), _given(one), one.help) for one in command.options]
    table = _table(("option", "value", "if left out", "meaning"), rows)
    settings = f"\nIts settings: [{command.name}](settings.md#{_anchor(command.name)}).\n" if command.settings else ""
    example = f"\nExample:\n\n```text\nlegtool {command.example}\n```\n" if command.example else ""
    return head + "\n" + table + settings + example


def _usage(option: Option) -> str:
    return option.name if option.needed else f"[{option.name}]"


def _kind(option: Option) -> str:
    if option.type is bool:
        return "flag"
    if option.type is Path:
        return "path"
    if get_origin(option.type) is list:
        return "KEY=VALUE, may be repeated"
    return _type(option.type, ()) + (f", at least {option.least}" if option.least is not None else "")


def _given(option: Option) -> str:
    if option.needed:
        return "needed"
    if option.setting:
        return "the setting of this name"
    if option.name == "--workers":  # the number of cores of the machine that makes this page says nothing
        return "1" if option.default == 1 else "the number of cores"
    return "–" if option.default is None else f"`{option.default}`"


def settings() -> str:
    """The page of all settings, as MyST Markdown."""
    out = [
        "# Settings\n",
        "This page is made from the classes that check the settings. A setting comes from (later wins) its default, "
        "`--config FILE` (or a dataset, run or results, whose settings are taken), `--set key=value`, and the option "
        "of its name. Dots reach into groups: `--set planner.margin_m=0.02`. `--show-config` prints all settings of a "
        "command as YAML, which `--config` takes. Unknown keys and values out of range are refused in one line.\n\n"
        "Lengths are in metres, times in seconds, angles in radians, unless a unit stands in brackets.\n",
    ]
    for command in COMMANDS:
        if command.settings:
            out.append(f"## {command.name}\n\n{_settings_table(command.settings)}")
            for name, when, where in OTHERS:
                if name == command.name:
                    out.append(f"### {name} {when}\n\n{_settings_table(where)}")
    out.append("## Files\n")
    for title, taken, where in FILES:
        out.append(f"### {title}\n\nTaken by {taken}.\n\n{_settings_table(where)}")
    return "\n".join(out)


def _settings_table(where: str) -> str:
    rows = [
        (f"`{row.key}`", row.type, "must be given" if row.default is None else row.default, row.meaning)
        for row in rows_of(_named(where))
    ]
    return _table(("key", "type", "default", "meaning"), rows)


def _named(where: str) -> Any:
    module, _, name = where.partition(":")
    return getattr(importlib.import_module(module), name)


def rows_of(cls: type, default: Any = None, prefix: str = "") -> Iterator[Row]:
    """The settings of a class, and of the groups in it.

    Args:
        cls: a settings model, or a dataclass that nests in one.
        default: an instance, whose values are the defaults; None: those of the class.
        prefix: of the keys.
    """
    told = descriptions(cls)
    refused = {old for old in getattr(cls, "renamed", {})}
    hints = get_type_hints(cls, include_extras=True)
    for name, field in _fields(cls):
        if name in refused or name.startswith("_"):
            continue
        given = MISSING if default is None else getattr(default, name, MISSING)
        value = _default(field) if given is MISSING else given
        kind = hints[name]
        group, into = _group_in(kind)
        key = prefix + name
        bounds = field.metadata if isinstance(field, FieldInfo) else ()
        if group is None:
            yield Row(key, _type(kind, bounds), None if value is MISSING else _plain(value), told.get(name, ""))
            continue
        held = value if isinstance(value, group) else None
        yield Row(key, into, _default_of_group(value, held), told.get(name, "") or _summary(group))
        inside = {"group": ".", "group or null": ".", "list of groups": "[].", "groups by name": ".NAME."}[into]
        hidden = {old.partition(".")[2] for old in refused if old.startswith(f"{name}.")}
        yield from (row for row in rows_of(group, held, key + inside) if row.key[len(key + inside) :] not in hidden)


def _fields(cls: type) -> list[tuple[str, FieldInfo | Field[Any]]]:
    if issubclass(cls, BaseModel):
        return list(cls.model_fields.items())
    return [(field.name, field) for field in fields(cls) if field.init]


def _default(field: FieldInfo | Field[Any]) -> Any:
    if isinstance(field, FieldInfo):
        return MISSING if field.is_required() else field.get_default(call_default_factory=True)
    if field.default_factory is not MISSING:
        return field.default_factory()
    return field.default


def _default_of_group(value: Any, held: Any) -> str | None:
    if value is MISSING:
        return None
    return "as below" if held is not None else _plain(value)


def _group_in(kind: Any) -> tuple[type | None, str]:
    """The class of settings that a type holds, and how; None where it holds plain values."""
    kind = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    if inspect.isclass(kind) and (issubclass(kind, BaseModel) or is_dataclass(kind)):
        return kind, "group"
    arms = [arm for arm in get_args(kind) if arm not in (type(None), Ellipsis)]
    found = next((arm for arm in arms if _group_in(arm)[1] == "group"), None)
    if found is None:
        return None, ""
    group = _group_in(found)[0]
    if get_origin(kind) in (tuple, list):
        return group, "list of groups"
    return group, "groups by name" if get_origin(kind) is dict else "group or null"


_NAMES = {float: "number", int: "whole number", str: "text", bool: "true or false", Path: "path", Any: "any value"}
_SIGNS: dict[type, tuple[str, str]] = {
    annotated_types.Gt: ("gt", ">"),
    annotated_types.Ge: ("ge", "≥"),
    annotated_types.Lt: ("lt", "<"),
    annotated_types.Le: ("le", "≤"),
}


def _type(kind: Any, bounds: Sequence[Any]) -> str:
    """A type in words, with its bounds."""
    if get_origin(kind) is Annotated:
        kind, *held = get_args(kind)
        inner = [entry for one in held for entry in (one.metadata if isinstance(one, FieldInfo) else [one])]
        return _type(kind, [*inner, *bounds])
    limits = [
        f"{sign} {getattr(bound, key):g}"
        for bound in bounds
        for cls, (key, sign) in _SIGNS.items()
        if isinstance(bound, cls)
    ]
    return ", ".join([_words(kind), *dict.fromkeys(limits)])


def _words(kind: Any) -> str:
    if kind in _NAMES:
        return _NAMES[kind]
    origin, arms = get_origin(kind), get_args(kind)
    if origin is Literal:
        return " or ".join(f"`{arm}`" for arm in arms)
    if origin in (Union, types.UnionType):
        named = [_type(arm, ()) for arm in arms if arm is not type(None)]
        return " or ".join((["null"] if len(named) < len(arms) else []) + named)
    if origin in (tuple, list):
        if len(arms) == 1 or arms[-1] is Ellipsis:
            return f"list of: {_type(arms[0], ())}"
        same = len(set(arms)) == 1
        return f"{len(arms)} of: {_type(arms[0], ())}" if same else "; ".join(_type(arm, ()) for arm in arms)
    if origin is dict:
        return f"values by name, each {_type(arms[1], ())}"
    return getattr(kind, "__name__", str(kind))


def _plain(value: Any) -> str:
    """A default as YAML writes it."""
    if isinstance(value, BaseModel):
        value = value.model_dump(mode="json")
    text = yaml.safe_dump(_listed(value), default_flow_style=True, width=10**9).removesuffix("...\n").strip()
    return f"`{text}`" if len(text) <= _LONGEST else f"`{text[: _LONGEST - 2]} …`"


def _listed(value: Any) -> Any:
    if isinstance(value, (tuple, list, set, frozenset)):
        return [_listed(item) for item in value]
    if isinstance(value, dict):
        return {str(name): _listed(item) for name, item in value.items()}
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    return value if isinstance(value, (int, float, str, bool, type(None))) else str(value)


def _summary(cls: type) -> str:
    return inspect.cleandoc(cls.__doc__ or "").partition("\n")[0]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(_cell(text) for text in row) + " |" for row in cells) + "\n"


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())


def _anchor(title: str) -> str:
    """As MyST makes it from a heading."""
    return title.replace(" ", "-")


def modules(package: types.ModuleType) -> list[str]:
    """Public modules of a package, in the order of their names; the program's own entry left out."""
    found = pkgutil.walk_packages(package.__path__, package.__name__ + ".")
    names = [one.name for one in found if not any(part.startswith("_") for part in one.name.split("."))]
    return [package.__name__, *sorted(names)]


def _room(module: str, deep: int) -> str:
    """The page that a module stands on: its first names."""
    return ".".join(module.split(".")[:deep])


def api(package: types.ModuleType) -> dict[str, str]:
    """Pages of a package's API: a page for each room that stands directly in it.

    Returns:
        Page name to reStructuredText.
    """
    pages: dict[str, list[str]] = {}
    for name in modules(package):
        pages.setdefault(_room(name, 2), []).append(name)
    out = {}
    for page, names in pages.items():
        parts = [f"{page}\n{'=' * len(page)}\n"]
        for name in names:
            if name != page:
                parts.append(f"{name}\n{'-' * len(name)}\n")
            parts.append(f".. automodule:: {name}\n")
        out[page] = "\n".join(parts)
    return out


def _api_index(pages: dict[str, list[str]]) -> str:
    text = (
        "# Python API\n\nThese pages are made from the docstrings. `legtool_runtime` is what runs on the robot: what "
        "is public in it is meant for you. `legtool` is the offline toolkit, whose stable interface is the command "
        "line: its modules may change between versions.\n"
    )
    for package, names in pages.items():
        text += f"\n## {package}\n\n```{{toctree}}\n:maxdepth: 1\n\n" + "\n".join(names) + "\n```\n"
    return text


def write(folder: Path, *, api: bool) -> None:
    """Write all generated pages.

    Args:
        folder: where to, made anew; files that would not change are left as they are.
        api: whether the Python API is among them.
    """
    pages = {"commands.md": commands(), "settings.md": settings()}
    contents: dict[str, list[str]] = {}
    if api:
        for package in (legtool_runtime, legtool):
            made = globals()["api"](package)
            contents[package.__name__] = list(made)
            pages |= {f"{name}.rst": text for name, text in made.items()}
    pages["api.md"] = _api_index(contents)
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        if old.name not in pages:
            old.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
