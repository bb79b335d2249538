"""Ends what does not come back: a controller that sleeps or a planner that loops loses its trial, not the suite."""

from __future__ import annotations

import signal
import threading
from types import FrameType

from legtool.errors import ControllerError
from legtool.sim.walks.environment import Answer, Observation

#: What the first time may take longer than the others: kernels are compiled [s].
_COMPILING_S = 300.0


class Watchdog:
    """Raises ControllerError in the walk where no tick comes for too long; a :class:`.Subscriber`.

    It interrupts Python code, sleeping or running, in a process's main thread on POSIX; elsewhere it does nothing.
    """

    def __init__(self, limit_s: float) -> None:
        self.limit_s = limit_s
        self._works = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()

    def begin(self) -> None:
        """Begin to count."""
        if self._works:
            self._before = signal.signal(signal.SIGALRM, self._bark)
            signal.setitimer(signal.ITIMER_REAL, self.limit_s + _COMPILING_S)

    def tick(self, observation: Observation, answer: Answer) -> None:
        """All is well: begin to count anew."""
        del observation, answer
        if self._works:
            signal.setitimer(signal.ITIMER_REAL, self.limit_s)

    def end(self) -> None:
        """Stop counting."""
        if self._works:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, self._before)

    def _bark(self, number: int, frame: FrameType | None) -> None:
        raise ControllerError(f"controller or planner gave no answer for {self.limit_s:g} s")
