"""What a table of commands is made of, and how its commands are found, called and ended.

A user's mistake ends in one line and exit code 2, Ctrl-C in one line and 130, a defect in one line and 1.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from legtool.errors import LegtoolError, SettingsError
from legtool.progress import silence
from legtool.workers import LeftToOthers, Workers

if TYPE_CHECKING:
    from legtool.configs.settings import Settings

T = TypeVar("T", bound="Settings")

_HELP: dict[str, Any] = {"context_settings": {"help_option_names": ["-h", "--help"]}}
_STYLE: dict[str, Any] = {"add_completion": False, "rich_markup_mode": None, "pretty_exceptions_enable": False, **_HELP}


@dataclass(frozen=True)
class Option:
    """An option or an argument of a command.

    Attributes:
        name: ``--robot`` for an option, ``RUN`` for an argument, ``DATA...`` for one that may be repeated.
        help: what it means.
        type: of its value; ``bool`` for a flag, ``list[...]`` for an option that may be repeated.
        setting: whether it gives the setting of the same name.
        needed: what to do if it is missing, where the command cannot run without it.
        default: where it is left out.
        least: of a whole number.
        offers: values that a shell completes.
    """

    name: str
    help: str
    type: Any = str
    setting: bool = False
    needed: str = ""
    default: Any = None
    least: int | None = None
    offers: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Its name in :class:`Arguments`."""
        return self.name.strip("-.").replace("-", "_").lower()

    def parameter(self, shown: str = "") -> inspect.Parameter:
        """The parameter that Typer reads it from; ``shown`` follows its help."""
        name, several, _ = self.name.partition("...")
        kind: Any = list[self.type] if several else self.type  # type: ignore[name-defined]  # made at run time
        if name.startswith("-"):
            how = typer.Option(
                name, help=self.help + shown, min=self.least, metavar=_METAVARS.get(name), autocompletion=self._offer
            )
        else:
            how = typer.Argument(help=self.help, metavar=self.name)
        if self.type is not bool:
            kind = kind | None
        annotation = Annotated[kind, how]
        default = False if self.type is bool else self.default
        return inspect.Parameter(self.key, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)

    def _offer(self, incomplete: str) -> list[str]:
        return [value for value in self.offers if value.startswith(incomplete)]


_METAVARS = {"--set": "KEY=VALUE"}
_DEBUG = Option("--debug", "show the traceback of an error", bool)
_QUIET = Option("--quiet", "print nothing but errors", bool)


class Arguments:
    """What a command was given, by the keys of its options; None for an option that was left out."""

    def __init__(self, command: Command, values: Mapping[str, Any]) -> None:
        self.command = command
        #: The last word of the command's name.
        self.task = command.name.split()[-1]
        self.values = {**values, "task": self.task}

    def __getattr__(self, key: str) -> Any:
        try:
            return self.__dict__["values"][key]
        except KeyError:
            raise AttributeError(key) from None

    def settings(self, cls: type[T]) -> T:
        """Settings of a class, from the options; with ``--show-config`` they are printed and the command ends.

        Raises:
            SettingsError: a setting is unknown, of the wrong type or out of range.
        """
        from legtool.configs.settings import load

        named = {option.key: self.values[option.key] for option in self.command.options if option.setting}
        allowed = bool(self.values.get("allow_code"))
        settings = load(cls, self.config, self.set or (), allow_code=allowed, **named)
        if self.show_config:
            print(settings.to_yaml(), end="")
            sys.exit(0)
        return settings

    def workforce(self) -> Workers:
        """Who does the work.

        Raises:
            SettingsError: it is not told rightly.
        """
        told = (self.values.get(key) for key in ("cluster", "shard", "limit", "out"))
        return Workers.parse(self.values["workers"], *told)


@dataclass(frozen=True)
class Command:
    """A row of the table.

    Attributes:
        name: the words that call it.
        run: does the work and returns lines to print as they come; its docstring is the command's help.
        options: all that it takes besides ``--debug`` and ``--help``.
        writes: what is said to have been written in the end, with keys of options, or ``task``, in braces.
        then: the command to run next, likewise; left out if an option that it names was not given.
        settings: module and class of its settings, with a colon between, whose defaults its help shows.
        example: a command line that its help ends with, without the program's name.
        mend: what to do next where the verdict on what was written is red, instead of ``then``.
    """

    name: str
    run: Callable[[Arguments], Iterable[str]]
    options: tuple[Option, ...]
    writes: str = ""
    then: str = ""
    settings: str = ""
    example: str = ""
    mend: str = ""

    @property
    def help(self) -> str:
        """What it does."""
        return self.run.__doc__ or ""

    def register(self, group: typer.Typer, *, defaults: bool = False) -> None:
        """Add it to its group: called on the command line it returns what it was given.

        Args:
            group: that it belongs to.
            defaults: whether its help shows the defaults of settings, for which their module is imported.
        """
        shown = self._defaults() if defaults else {}

        def given(**values: Any) -> Arguments:
            return Arguments(self, values)

        parameters = [option.parameter(shown.get(option.key, "")) for option in (*self.options, _QUIET, _DEBUG)]
        given.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # inspect reads it, typeshed has it not
        given.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        example = f"Example: legtool {self.example}" if self.example else None
        group.command(self.name.split()[-1], help=self.help, epilog=example, **_HELP)(given)

    def _defaults(self) -> dict[str, str]:
        """By the keys of options that give settings, what follows their help."""
        module, _, name = self.settings.partition(":")
        if not module:
            return {}
        values = getattr(importlib.import_module(module), name)().to_dict()
        keys = [option.key for option in self.options if option.setting and values.get(option.key) is not None]
        return {key: f" [default: {_plain(values[key])}]" for key in keys}

    def execute(self, given: Arguments) -> None:
        """Run it, and print what it says: lines, what it wrote and what comes next, or with ``--json`` its results.

        Raises:
            SettingsError: an option that it needs is missing.
        """
        for option in self.options:
            # Settings can be shown before it is known what to work on.
            if option.needed and not given.values[option.key] and not given.values.get("show_config"):
                raise SettingsError(f"{option.name.strip('.')} is missing: {option.needed}")
        self._tell(given)
        if given.values.get("check") and self._red(given):
            raise SystemExit(1)

    def _red(self, given: Arguments) -> bool:
        """Whether the verdict on what it wrote is red: results of an evaluation, or a dataset."""
        written: list[Path] = (
            [given.out / name for name in ("results.json", "manifest.json")] if given.values.get("out") else []
        )
        there = [path for path in written if path.is_file()]
        found: dict[str, Any] = json.loads(there[0].read_text(encoding="utf-8")) if there else {}
        return bool(found.get("verdict", {}).get("level") == "red")

    def _tell(self, given: Arguments) -> None:
        as_json = bool(given.values.get("json"))
        if given.values.get("quiet") or as_json:
            silence()
        for line in self.run(given):
            if not given.values.get("quiet") and (not as_json or not self.writes):
                print(line, flush=True)
        if as_json and self.writes:
            print((given.out / "results.json").read_text(encoding="utf-8"), end="")
        if as_json or given.values.get("quiet"):
            return
        known = {key: value for key, value in given.values.items() if value is not None}
        then = self.mend if self.mend and self._red(given) else self.then
        for label, text in (("wrote", self.writes), ("next:", then)):
            if text:
                with contextlib.suppress(KeyError):
                    print(label, text.format_map(known))


def _plain(value: Any) -> str:
    """A default as it is given on the command line."""
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _show_version(asked: bool) -> None:
    if asked:
        print(f"legtool {version('legtool')}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool, typer.Option("--version", help="show the version and exit", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    pass


def parse(commands: Sequence[Command], groups: Mapping[str, str], words: Sequence[str]) -> Arguments | None:
    """Read a command line; help is printed and gives None.

    Args:
        commands: the table.
        groups: what the first words of commands stand for, and ``""``, the program.
        words: the command line without the program's name.

    Raises:
        SettingsError: a command or an option is unknown, malformed or missing.
    """
    apps = {name: typer.Typer(help=text, **{**_STYLE, "add_completion": not name}) for name, text in groups.items()}
    asks = not {"-h", "--help"}.isdisjoint(words)
    for command in commands:
        asked = asks and list(words[: len(command.name.split())]) == command.name.split()
        command.register(apps[" ".join(command.name.split()[:-1])], defaults=asked)
    apps[""].callback()(_root)
    for name, app in apps.items():
        if name:
            apps[""].add_typer(app, name=name)
    program = typer.main.get_command(apps[""])
    try:
        found = program.main(list(words), prog_name="legtool", standalone_mode=False)
    except Exception as error:  # Typer's own errors of usage have no public base in all versions
        if not hasattr(error, "format_message"):
            raise
        raise SettingsError(_usage(error)) from error
    return found if isinstance(found, Arguments) else None


def _usage(error: Any) -> str:
    """One line for a mistake of usage: where, what, and what is expected there."""
    context, message = error.ctx, error.format_message().partition(" Did you mean")[0].rstrip(".")
    if context is None:
        return f"legtool: {message}"
    where = context.command_path
    if names := sorted(getattr(context.command, "commands", {})):
        return f"{where}: {message[0].lower()}{message[1:]}; expected one of: {', '.join(names)}"
    if "No such option" in message:
        taken = [one.opts[0] for one in context.command.params if one.opts[0].startswith("-")]
        return f"{where} does not take {error.option_name!r}; it takes {', '.join(taken)}"
    return f"{where}: {message}; see {where} --help"


def call(commands: Sequence[Command], groups: Mapping[str, str], words: Sequence[str]) -> int:
    """Call the command that a command line names.

    Args:
        commands: the table.
        groups: what the first words of commands stand for, and ``""``, the program.
        words: the command line without the program's name.

    Returns:
        the exit code.
    """
    try:
        given = parse(commands, groups, words)
        if given is not None:
            given.command.execute(given)
        return 0
    except BrokenPipeError:  # who read what was printed has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except LeftToOthers as left:
        print(left)
        return 0
    except KeyboardInterrupt:
        message, code = "interrupted: finished work is kept; run the same command again to continue", 130
    except Exception as error:
        if "--debug" in words:
            raise
        message, code = _explain(error)
    print(" ".join(message.split()), file=sys.stderr)
    return code


def _explain(error: Exception) -> tuple[str, int]:
    if isinstance(error, LegtoolError):
        return f"error: {error}", getattr(error, "exit_code", 2)
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"error: {where}{error.strerror or error}", 2
    kind = type(error).__name__
    return f"internal error: {kind}: {error}; run again with --debug for the traceback, and report it", 1
