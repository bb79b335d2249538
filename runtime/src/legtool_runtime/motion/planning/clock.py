"""The system's monotonic clock, read from compiled code, and the deadline of a search."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

#: The clock that :func:`now` reads: a POSIX system's, so that Python and compiled code speak of one time.
CLOCK = int(getattr(time, "CLOCK_MONOTONIC", 1))
#: The deadline of a search that is never cut: the clock is not even read.
NEVER = (1 << 63) - 1
# Resolved by name in the running process: a ctypes pointer would keep numba from storing the compiled kernel.
_clock_gettime: Any = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.voidptr))
#: Entries of a watch; the first two are the system's timespec. The last reading, and the longest pause between two.
_READ, _PAUSE = 2, 3
#: Length of a watch: an int64 array, so that compiled functions can share it.
WATCH = 4


@kernel
def now(watch: NDArray[np.int64]) -> int:
    """Nanoseconds of the monotonic clock; the first two entries of ``watch`` are overwritten (64-bit systems)."""
    _clock_gettime(CLOCK, watch.ctypes)
    return watch[0] * 1_000_000_000 + watch[1]


@kernel
def watch_from_now(watch: NDArray[np.int64], deadline: int) -> None:
    """Begin to watch a deadline [ns of :data:`CLOCK`]; with NEVER nothing is read or written."""
    if deadline != NEVER:
        watch[_READ] = now(watch)
        watch[_PAUSE] = 0


@kernel
def late(watch: NDArray[np.int64], deadline: int) -> bool:
    """Whether another pause as long as the longest between two calls so far would end past the deadline."""
    if deadline == NEVER:
        return False
    time = now(watch)
    watch[_PAUSE] = max(watch[_PAUSE], time - watch[_READ])
    watch[_READ] = time
    return time + watch[_PAUSE] >= deadline
