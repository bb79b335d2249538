"""The system's monotonic clock, read from compiled code."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

#: The clock that :func:`now` reads: a POSIX system's, so that Python and compiled code speak of one time.
CLOCK = int(getattr(time, "CLOCK_MONOTONIC", 1))
# Resolved by name in the running process: a ctypes pointer would keep numba from storing the compiled kernel.
_clock_gettime: Any = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.voidptr))


@kernel
def now(timespec: NDArray[np.int64]) -> int:
    """Nanoseconds of the monotonic clock; ``timespec`` (2,) is overwritten (64-bit systems)."""
    _clock_gettime(CLOCK, timespec.ctypes)
    return timespec[0] * 1_000_000_000 + timespec[1]
