"""A process that runs one thing after the other, and can be killed."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

#: Numerical libraries of a worker use one thread: there is a worker for each core.
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class WorkerKilled(Exception):
    """The process that worked on an item was killed, or ended by itself."""

    def __str__(self) -> str:
        return "its process was killed; by the system for want of memory?"


class TookTooLong(Exception):
    """An item took longer than it may; its process was ended."""


class OwnProcess:
    """A process that runs one function after the other in its main thread, and can be killed."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None

    def run(self, function: Callable[[Any], None], item: Any, limit_s: float | None) -> None:
        """Run a function on an item.

        Raises:
            WorkerKilled: the process died.
            TookTooLong: it took longer than ``limit_s``, and the process was killed.
            Exception: what the function raised.
        """
        if self._pool is None:
            self._pool = _pool()
        began = time.monotonic()
        try:
            self._pool.submit(function, item).result(limit_s)
        except BrokenProcessPool as error:
            self.end(now=True)
            raise WorkerKilled from error
        except TimeoutError as error:
            if limit_s is None or time.monotonic() - began < limit_s:
                raise  # the function's own
            self.end(now=True)
            raise TookTooLong(f"took longer than {limit_s:g} s") from error

    def end(self, *, now: bool) -> None:
        """End the process; ``now``: even if it works."""
        pool, self._pool = self._pool, None
        if pool is None:
            return
        if now:  # work in the making is worth nothing until it is whole
            for process in list((pool._processes or {}).values()):
                process.kill()
        pool.shutdown(wait=not now, cancel_futures=True)


_STARTING = threading.Lock()


def _pool() -> ProcessPoolExecutor:
    with _STARTING:  # the environment is one
        return _one_process()


def _one_process() -> ProcessPoolExecutor:
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker)
    try:
        pool.submit(os.getpid)  # starts the process, with these variables
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
    return pool


def _start_worker() -> None:
    """Leave Ctrl-C to the parent, and end when the parent is gone, however it went."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
