"""Run a function over many items: in this process, in several, or on a cluster, with progress and without orphans.

Each item's result is left on disk, so that a command which was interrupted, a worker that was killed, or an item that
failed cost that item alone: the same command does what is missing.
"""

from __future__ import annotations

import re
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

from legtool.errors import LegtoolError, PartsFailed, SettingsError
from legtool.processes import OwnProcess, TookTooLong, WorkerKilled
from legtool.progress import progress
from legtool_runtime.errors import one_line

Item = TypeVar("Item")
#: How often an item is tried before the others go on without it.
TRIES = 3
#: So many failed items are named.
_NAMED = 10


class LeftToOthers(Exception):
    """The shard's own items are done, and other shards' are not: there is nothing to sum up yet."""


@dataclass(frozen=True)
class Workers:
    """Who does a command's work.

    Attributes:
        processes: on this machine; 1: the command's own.
        cluster: address of a Dask scheduler, or ``local:N`` for N workers of one that is started here; None: none.
        shard: (K, N): items whose place among all is K modulo N are done by this command, the others elsewhere.
        limit_s: longest time for one item [s]; then its process is ended.
        out: directory that results are written into, which all machines of a cluster have to see.
    """

    processes: int = 1
    cluster: str | None = None
    shard: tuple[int, int] = (0, 1)
    limit_s: float | None = None
    out: Path = Path()

    @classmethod
    def of(cls, workers: int | Workers) -> Workers:
        """The same; a number is one of processes."""
        return cls(workers) if isinstance(workers, int) else workers

    @classmethod
    def parse(
        cls, processes: int, cluster: str | None, shard: str | None, limit_s: float | None, out: Path | None
    ) -> Workers:
        """From what the command line gives.

        Raises:
            SettingsError: a shard that is not K/N with 0 <= K < N, or a limit that is no time.
        """
        if limit_s is not None and not 0 < limit_s < float("inf"):
            raise SettingsError(f"--limit {limit_s:g}: expected seconds above 0")
        where = out or Path()
        if shard is None:
            return cls(processes, cluster, limit_s=limit_s, out=where)
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", shard)
        if found is None or int(found[1]) >= int(found[2]):
            raise SettingsError(f"--shard {shard}: expected K/N with K from 0 to N - 1, such as 0/4")
        return cls(processes, cluster, (int(found[1]), int(found[2])), limit_s, where)

    @property
    def name(self) -> str | None:
        """Of the shard; None where one command does all."""
        return None if self.shard == (0, 1) else "{}-of-{}".format(*self.shard)

    def takes(self, place: int) -> bool:
        """Whether the item at a place among all is this command's."""
        return place % self.shard[1] == self.shard[0]


class Crew(Protocol):
    """What items are handed to.

    Attributes:
        window: so many may be in its hands at once.
    """

    window: int

    def submit(self, function: Callable[[Any], None], item: Any, limit_s: float | None) -> Future[None]:
        """Begin an item."""
        ...

    def leave(self, *, now: bool) -> None:
        """End; ``now``: without waiting for what is in hand."""
        ...


def run_all(
    function: Callable[[Item], None],
    items: Sequence[Item],
    *,
    workers: int | Workers,
    description: str,
    unit: str,
    done: int = 0,
) -> None:
    """Call ``function`` on every item; it leaves its result on disk.

    An item that ends in an error which is none of the user's is tried again, up to three times; then the rest goes on.

    Args:
        function: picklable where others than this process work.
        items: what is left to do.
        workers: who works.
        description: for the progress bar.
        unit: what an item is, in the plural.
        done: items that an earlier run finished.

    Raises:
        PartsFailed: some items failed, the message names them; all others are done.
    """
    workers = Workers.of(workers)
    total = done + len(items)
    with progress(description, total, unit, done=done) as advance, _crew(workers, len(items)) as crew:
        failed = _work(function, items, crew, workers.limit_s, advance)
    if failed:
        told = ", ".join(f"{item} ({_short(error)})" for item, error in list(failed.items())[:_NAMED])
        more = f" and {len(failed) - _NAMED} more" if len(failed) > _NAMED else ""
        raise PartsFailed(
            f"{total - len(failed)} of {total} {unit} are done; failed {TRIES} times each: {told}{more}; the same "
            "command tries these again"
        ) from next(iter(failed.values()))


def _work(
    function: Callable[[Item], None],
    items: Sequence[Item],
    crew: Crew,
    limit_s: float | None,
    advance: Callable[[float], None],
) -> dict[Item, BaseException]:
    """Do all items; those that failed too often, and their last errors."""
    waiting = deque(items)
    running: dict[Future[None], Item] = {}
    tries: Counter[Item] = Counter()
    failed: dict[Item, BaseException] = {}
    while waiting or running:
        while waiting and len(running) < crew.window:
            item = waiting.popleft()
            running[crew.submit(function, item, limit_s)] = item
        finished, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in finished:
            item = running.pop(future)
            error = future.exception()
            if error is None:
                advance(1)
            elif isinstance(error, (LegtoolError, OSError)) or not isinstance(error, Exception):
                raise error
            else:
                tries[item] += 1
                if tries[item] < TRIES:
                    waiting.append(item)
                else:
                    failed[item] = error
    return failed


def _short(error: BaseException) -> str:
    text = str(error) or type(error).__name__
    named = text if isinstance(error, (WorkerKilled, TookTooLong)) else f"{type(error).__name__}: {text}"
    return one_line(named, 120)


@contextmanager
def _crew(workers: Workers, count: int) -> Iterator[Crew]:
    """Who works on so many items; they are gone afterwards, at once if there was an error."""
    crew: Crew
    if workers.cluster is not None:
        from legtool.cluster import Cluster

        crew = Cluster(workers.cluster, workers.out)
    elif workers.limit_s is None and (workers.processes == 1 or count < 2):
        crew = _Here()
    else:
        crew = _Processes(max(1, min(workers.processes, count)))
    try:
        yield crew
    except BaseException:
        crew.leave(now=True)
        raise
    crew.leave(now=False)


class _Here:
    """This process."""

    window = 1

    def submit(self, function: Callable[[Any], None], item: Any, limit_s: float | None) -> Future[None]:
        done: Future[None] = Future()
        try:
            function(item)
            done.set_result(None)
        except Exception as error:
            done.set_exception(error)
        return done

    def leave(self, *, now: bool) -> None: ...


class _Processes:
    """Processes of this machine, each with an item of its own in a thread that waits for it."""

    def __init__(self, count: int) -> None:
        self.window = count
        self._idle = deque(OwnProcess() for _ in range(count))
        self._all = list(self._idle)

    def submit(self, function: Callable[[Any], None], item: Any, limit_s: float | None) -> Future[None]:
        process = self._idle.popleft()
        done: Future[None] = Future()

        def work() -> None:
            try:
                process.run(function, item, limit_s)
                error = None
            except BaseException as raised:
                error = raised
            self._idle.append(process)
            done.set_result(None) if error is None else done.set_exception(error)

        threading.Thread(target=work, daemon=True).start()
        return done

    def leave(self, *, now: bool) -> None:
        for process in self._all:
            process.end(now=now)
