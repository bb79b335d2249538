"""Run a function over many items, in this process or in several, with progress, and without orphans."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

from legtool.progress import progress

Item = TypeVar("Item")


def run_all(
    function: Callable[[Item], None],
    items: Sequence[Item],
    *,
    workers: int,
    description: str,
    unit: str,
    done: int = 0,
) -> None:
    """Call ``function`` on every item; it leaves its result on disk.

    Args:
        function: picklable where ``workers`` > 1.
        items: what is left to do.
        workers: processes.
        description: for the progress bar.
        unit: what an item is, in the plural.
        done: items that an earlier run finished.
    """
    with progress(description, done + len(items), unit, done=done) as advance:
        if workers == 1 or len(items) < 2:
            for item in items:
                function(item)
                advance(1)
        else:
            _run_in_processes(function, items, workers, advance)


def _run_in_processes(
    function: Callable[[Item], None], items: Sequence[Item], workers: int, advance: Callable[[float], None]
) -> None:
    pool = ProcessPoolExecutor(
        min(workers, len(items)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
    )
    try:
        for future in as_completed([pool.submit(function, item) for item in items]):
            future.result()
            advance(1)
    except BaseException:
        # Work in the making is worth nothing until it is whole: end its process rather than wait for it.
        for process in multiprocessing.active_children():
            process.terminate()
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def _start_worker() -> None:
    """Leave Ctrl-C to the parent, and end when the parent is gone, however it went."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
