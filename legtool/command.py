"""What a table of commands is made of, and how its commands are found, called and ended.

A user's mistake ends in one line and exit code 2, Ctrl-C in one line and 130, a defect in one line and 1.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

from legtool.errors import LegtoolError, SettingsError

if TYPE_CHECKING:
    from legtool.configs.settings import Settings

T = TypeVar("T", bound="Settings")


@dataclass(frozen=True)
class Option:
    """An option or an argument of a command.

    Attributes:
        name: ``--robot`` for an option, ``RUN`` for an argument, ``DATA...`` for one that may be repeated.
        help: what it means.
        setting: whether it gives the setting of the same name.
        needed: what to do if it is missing, where the command cannot run without it.
        how: further keywords of :meth:`argparse.ArgumentParser.add_argument`.
    """

    name: str
    help: str
    setting: bool = False
    needed: str = ""
    how: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Its name in :class:`Arguments`."""
        return self.name.strip("-.").replace("-", "_").lower()


class Arguments(argparse.Namespace):
    """What a command was given, by the keys of its options; None for an option that was left out."""

    options: Sequence[Option]
    #: The last word of the command's name.
    task: str

    def settings(self, cls: type[T]) -> T:
        """Settings of a class, from the options; with ``--show-config`` they are printed and the command ends.

        Raises:
            SettingsError: a setting is unknown, of the wrong type or out of range.
        """
        from legtool.configs.settings import load

        named = {option.key: getattr(self, option.key) for option in self.options if option.setting}
        settings = load(cls, self.config, self.set, **named)
        if self.show_config:
            print(settings.to_yaml(), end="")
            sys.exit(0)
        return settings


@dataclass(frozen=True)
class Command:
    """A row of the table.

    Attributes:
        name: the words that call it.
        run: does the work and returns lines to print as they come; its docstring is the command's help.
        options: all that it takes besides ``--debug`` and ``--help``.
        writes: what is said to have been written in the end, with keys of options, or ``task``, in braces.
        then: the command to run next, likewise; left out if an option that it names was not given.
    """

    name: str
    run: Callable[[Arguments], Iterable[str]]
    options: tuple[Option, ...]
    writes: str = ""
    then: str = ""

    @property
    def help(self) -> str:
        """What it does."""
        return self.run.__doc__ or ""

    def parse(self, words: Sequence[str]) -> Arguments:
        """Read the words that follow its name.

        Raises:
            SettingsError: an option is unknown, malformed or missing.
        """
        parser = _Parser(f"legtool {self.name}", description=self.help, allow_abbrev=False)
        for option in self.options:
            how = {"help": option.help, **option.how}
            if option.name.startswith("-"):
                parser.add_argument(option.name, **how)
            else:
                name, *several = option.name.partition("...")
                parser.add_argument(option.key, metavar=name, nargs="*" if any(several) else "?", **how)
        parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
        given = Arguments(options=self.options, task=self.name.split()[-1])
        _, unknown = parser.parse_known_intermixed_args(words, given)
        if unknown:
            names = ", ".join(option.name for option in self.options)
            raise SettingsError(f"{parser.prog} does not take {unknown[0]!r}; it takes {names}")
        for option in self.options:
            # Settings can be shown before it is known what to work on.
            if option.needed and not getattr(given, option.key) and not getattr(given, "show_config", False):
                raise SettingsError(f"{option.name.strip('.')} is missing: {option.needed}")
        return given

    def call(self, words: Sequence[str]) -> None:
        """Run it on the words that follow its name, and print what it says."""
        given = self.parse(words)
        for line in self.run(given):
            print(line, flush=True)
        known = {key: value for key, value in vars(given).items() if value is not None}
        for label, text in (("wrote", self.writes), ("next:", self.then)):
            if text:
                with contextlib.suppress(KeyError):
                    print(label, text.format_map(known))


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise SettingsError(f"{self.prog}: {message}; see {self.prog} --help")


def whole_number(least: int) -> Callable[[str], int]:
    """The type of an option whose value is a whole number from ``least`` on."""

    def read(text: str) -> int:
        if not text.isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text} is not a whole number of at least {least}")
        return int(text)

    return read


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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
        for command in commands:
            name = command.name.split()
            if list(words[: len(name)]) == name:
                command.call(words[len(name) :])
                return 0
        return _overview(commands, groups, words)
    except KeyboardInterrupt:
        message, code = "interrupted: finished work is kept; run the same command again to continue", 130
    except Exception as error:
        if "--debug" in words:
            raise
        message, code = _explain(error)
    print(" ".join(message.split()), file=sys.stderr)
    return code


def _overview(commands: Sequence[Command], groups: Mapping[str, str], words: Sequence[str]) -> int:
    """Print the commands to choose from, of one group or all."""
    group, *rest = words if words and words[0] in groups else ("", *words)
    members = [command for command in commands if command.name.startswith(group)]
    if rest and rest[0] not in ("-h", "--help"):
        names = ", ".join(command.name for command in members)
        raise SettingsError(f"no command {' '.join([group, rest[0]]).strip()!r}; expected one of: {names}")
    usage = " ".join(f"legtool {group} COMMAND ...".split())
    parser = argparse.ArgumentParser(usage=usage, description=groups[group], add_help=False)
    listed = parser.add_argument_group("commands, each with --help of its own")
    for command in members:
        listed.add_argument(command.name, help=command.help)
    print(parser.format_help(), end="", file=sys.stdout if rest else sys.stderr)
    return 0 if rest else 2


def _explain(error: Exception) -> tuple[str, int]:
    if isinstance(error, LegtoolError):
        return f"error: {error}", 2
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"error: {where}{error.strerror or error}", 2
    kind = type(error).__name__
    return f"internal error: {kind}: {error}; run again with --debug for the traceback, and report it", 1
