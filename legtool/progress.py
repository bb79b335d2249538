"""Progress of long work: a bar with rate and time left on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

#: Seconds between plain lines when no terminal is attached.
PLAIN_INTERVAL_S = 15.0

_silent = False


def silence() -> None:
    """Show no progress from now on in this process."""
    global _silent
    _silent = True


Advance = Callable[[float], None]


@contextmanager
def progress(description: str, total: float, unit: str, *, done: float = 0.0) -> Iterator[Advance]:
    """Yield a function that advances the work by an amount of ``unit``; ``done`` was finished by an earlier run."""
    if _silent:
        yield lambda _: None
    elif sys.stderr.isatty():
        yield from _bar(description, total, unit, done)
    else:
        yield from _lines(description, total, unit, done)


def _bar(description: str, total: float, unit: str, done: float) -> Iterator[Advance]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    start = time.monotonic()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(description, total=total, completed=int(done), rate="")
        count = 0.0

        def advance(amount: float) -> None:
            nonlocal count
            count += amount
            rate = count / max(time.monotonic() - start, 1e-9)
            bar.update(task, advance=amount, rate=_rate(rate, unit))

        yield advance


def _rate(per_second: float, unit: str) -> str:
    """A rate, per minute or hour where it is slow."""
    for seconds, name in ((1.0, "s"), (60.0, "min")):
        if per_second * seconds >= 1.0:
            return f"{per_second * seconds:.1f} {unit}/{name}"
    return f"{per_second * 3600.0:.1f} {unit}/h"


def _left(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def _lines(description: str, total: float, unit: str, done: float) -> Iterator[Advance]:
    start = last = time.monotonic()
    count = 0.0

    def advance(amount: float) -> None:
        nonlocal count, last
        count += amount
        now = time.monotonic()
        if now - last >= PLAIN_INTERVAL_S:
            last = now
            rate = count / (now - start)
            left = (total - done - count) / max(rate, 1e-9)
            print(
                f"{description}: {done + count:.0f} of {total:.0f} {unit}, {_rate(rate, unit)}, {_left(left)} left",
                file=sys.stderr,
            )

    yield advance
