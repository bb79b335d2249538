"""What every command shares: its common options, its settings, and errors that end in one line and exit code 2."""

from __future__ import annotations

import functools
import importlib
import inspect
import os
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

T = TypeVar("T")

OPTIONS: dict[str, Any] = {
    "no_args_is_help": True,
    "add_completion": False,
    "rich_markup_mode": None,
    "pretty_exceptions_enable": False,
}
_COMMON: dict[str, tuple[Any, Any]] = {
    "asked_out": (
        Annotated[Path | None, typer.Option("--out", help="Directory to write; new, empty, or to be carried on.")],
        None,
    ),
    "config": (Annotated[Path | None, typer.Option("--config", help="YAML file of settings.")], None),
    "overrides": (Annotated[list[str] | None, typer.Option("--set", help="One setting, key=value; repeatable.")], None),
    "seed": (Annotated[int | None, typer.Option("--seed", help="Seed of everything random.")], None),
    "asked_workers": (
        Annotated[int | None, typer.Option("--workers", min=1, help="Processes; the result does not depend on it.")],
        None,
    ),
    "show_config": (
        Annotated[bool, typer.Option("--show-config", help="Print the full settings as YAML and exit.")],
        False,
    ),
    "debug": (Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")], False),
}


@dataclass(frozen=True)
class Common:
    """The options that every command has."""

    asked_out: Path | None
    config: Path | None
    overrides: list[str] | None
    seed: int | None
    asked_workers: int | None
    show_config: bool
    debug: bool

    def settings(self, name: str, **named: Any) -> Any:
        """Settings by ``module:class`` below legtool.configs; with ``--show-config`` they are printed, and that is all.

        Raises:
            SettingsError: a setting is unknown, of the wrong type or out of range.
        """
        from legtool.configs.settings import load

        module, _, attribute = name.partition(":")
        cls = getattr(importlib.import_module(f"legtool.configs.{module}"), attribute)
        settings = load(cls, self.config, self.overrides or (), **named, seed=self.seed)
        if self.show_config:
            print(settings.to_yaml(), end="")
            raise typer.Exit(0)
        return settings

    @property
    def out(self) -> Path:
        """The directory to write.

        Raises:
            SettingsError: it was not named.
        """
        return self.required(self.asked_out, "--out", "name the directory to write")

    @property
    def workers(self) -> int:
        """Processes: as asked, else one for each core."""
        if self.asked_workers is not None:
            return self.asked_workers
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

    def required(self, value: T | None, name: str, advice: str) -> T:
        """``value``, which must have been given.

        Raises:
            SettingsError: it was not.
        """
        if not value:
            from legtool.errors import SettingsError

            raise SettingsError(f"{name} is missing: {advice}")
        return value

    def say(self, lines: Iterable[str]) -> None:
        """Print lines as they come."""
        for line in lines:
            print(line, flush=True)


def command(group: typer.Typer, name: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a command whose first parameter is :class:`Common`; its other parameters are its own options."""

    def register(function: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(function)
        def run(**values: Any) -> None:
            common = Common(**{field.name: values.pop(field.name) for field in fields(Common)})
            try:
                function(common, **values)
            except typer.Exit:
                raise
            except KeyboardInterrupt:
                _stop("interrupted: what was finished is kept; run the same command again to carry on", 130)
            except Exception as error:
                if common.debug:
                    raise
                _stop(*_explain(error))

        own = list(inspect.signature(function, eval_str=True).parameters.values())[1:]
        shared = [
            inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
            for key, (annotation, default) in _COMMON.items()
        ]
        parameters = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in own] + shared
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # inspect reads it, typeshed has it not
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return group.command(name)(run)

    return register


def _explain(error: Exception) -> tuple[str, int]:
    from legtool.errors import LegtoolError

    if isinstance(error, LegtoolError):
        return f"error: {error}", 2
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"error: {where}{error.strerror or error}", 2
    kind = type(error).__name__
    return f"internal error: {kind}: {error}; run again with --debug for the traceback, and report it", 1


def _stop(message: str, code: int) -> None:
    print(" ".join(message.split()), file=sys.stderr)
    raise typer.Exit(code)
