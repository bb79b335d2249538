"""Run the missing parts of a dataset, in this process or in several."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

from legtool.datasets.store import Store
from legtool.progress import progress


def run_parts(
    store: Store,
    write: Callable[[int], None],
    *,
    total: int,
    workers: int,
    description: str,
    unit: str,
) -> dict[str, Any]:
    """Write every part that the store lacks and finish it.

    Args:
        store: the dataset being written.
        write: writes one part by its number; a pure function of that number, picklable where ``workers`` > 1.
        total: number of parts.
        workers: processes; the result is the same bytes whatever their number.
        description: for the progress bar.
        unit: what a part is, in the plural.

    Returns:
        the dataset's manifest.
    """
    pending = store.pending(total)
    with progress(description, total, unit, done=total - len(pending)) as advance:
        if workers == 1 or len(pending) < 2:
            for index in pending:
                write(index)
                advance(1)
        else:
            _run_in_processes(write, pending, workers, advance)
    return store.finish(total)


def _run_in_processes(
    write: Callable[[int], None], pending: list[int], workers: int, advance: Callable[[float], None]
) -> None:
    pool = ProcessPoolExecutor(
        min(workers, len(pending)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
    )
    try:
        for future in as_completed([pool.submit(write, index) for index in pending]):
            future.result()
            advance(1)
    except BaseException:
        # A part in the making is worth nothing until it is whole: end its process rather than wait for it.
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
