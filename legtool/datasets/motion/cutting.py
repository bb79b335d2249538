"""Find the steps of a recording while it is read: from step events, or from sampled rows with contact or kinematics."""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from statistics import median

import numpy as np
from numpy.typing import NDArray

from legtool.configs.motion import TransitionSettings
from legtool.datasets.logs.recording import Recording, concatenate
from legtool.datasets.motion.contacts import ContactState, Scale, calibrate, load_signal
from legtool.datasets.motion.steps import StepWriter, states
from legtool.datasets.motion.swings import SwingInterval, SwingTracker

Array = NDArray[np.float64]

#: Duration for which past rows are kept [s]: longer than a step, its end and the step before it.
_KEPT_S = 10.0
#: After this much of the recording, the ranges are derived from what has been read, walking or not [s].
_CALIBRATION_LIMIT_S = 120.0


class EventCutter:
    """Cuts recordings whose rows are touchdowns: each step leads from a row to the next."""

    def __init__(self, settings: TransitionSettings, writer: StepWriter) -> None:
        self._settings = settings
        self._writer = writer
        self._last: Recording | None = None

    def feed(self, chunk: Recording) -> None:
        """Process the next rows."""
        rows = chunk if self._last is None else concatenate([self._last, chunk])
        self._last = rows.rows(slice(-1, None))
        assert rows.swing_pair is not None
        at = states(rows, np.arange(len(rows)))
        for i, (start, end) in enumerate(pairwise(at)):
            seconds = (end.stamp_ns - start.stamp_ns) * 1e-9
            pair = int(rows.swing_pair[i + 1])
            if seconds > self._settings.max_step_s:
                self._writer.gap()
                continue
            self._writer.counts["recorded_s"] += seconds
            if pair not in (0, 1):
                self._writer.stumble("no_pair")
                continue
            self._writer.add(start, end, pair=pair, reference=rows.command[i])

    def finish(self) -> None:
        """Do nothing: no step is open after the last row."""


class SampledCutter:
    """Cuts recordings sampled at a steady rate: swings follow from contact, and steps from swings."""

    def __init__(self, settings: TransitionSettings, writer: StepWriter) -> None:
        self._settings = settings
        self._writer = writer
        self._scale: Scale | None = None
        self._waiting: list[Recording] = []  # rows read before the scale was known
        self._waited_s = self._walked_s = 0.0
        self._run: _Run | None = None
        self._last_ns = 0
        self._full_stances: deque[float] = deque(maxlen=31)

    def feed(self, chunk: Recording) -> None:
        """Process the next rows."""
        if self._scale is not None:
            self._cut(chunk)
            return
        self._waiting.append(chunk)
        previous = self._waiting[-2].stamps_ns[-1:] if len(self._waiting) > 1 else chunk.stamps_ns[:1]
        seconds = np.diff(np.concatenate([previous, chunk.stamps_ns])) * 1e-9
        seconds[seconds > self._settings.gap_s] = 0.0
        moving = (np.abs(chunk.command) > 1e-3).any(axis=1)
        waited = self._waited_s + np.cumsum(seconds)
        walked = self._walked_s + np.cumsum(seconds * moving)
        enough = (walked >= self._settings.calibration_s) | (waited >= _CALIBRATION_LIMIT_S)
        self._waited_s, self._walked_s = float(waited[-1]), float(walked[-1])
        if enough.any():
            # the row, not the chunk, at which there is enough: chunks' sizes must not change the result
            self._calibrate(unused=len(chunk) - int(np.argmax(enough)) - 1)

    def finish(self) -> None:
        """Finish the steps that are open when the recording ends."""
        if self._scale is None and self._waiting:
            self._calibrate(unused=0)
        if self._run is not None:
            self._run.finish()

    def _calibrate(self, unused: int) -> None:
        rows = concatenate(self._waiting)
        self._waiting = []
        self._scale = calibrate(rows.rows(slice(0, len(rows) - unused)), self._settings)
        self._cut(rows)

    def _cut(self, rows: Recording) -> None:
        assert self._scale is not None
        stamps = np.concatenate([[self._last_ns if self._run else rows.stamps_ns[0]], rows.stamps_ns])
        bounds = [0, *np.flatnonzero(np.diff(stamps) > round(self._settings.gap_s * 1e9)).tolist(), len(rows)]
        for number, (begin, end) in enumerate(pairwise(bounds)):
            if number > 0 and self._run is not None:
                self._run.finish()
                self._run = None
                self._writer.gap()
            if end > begin:
                if self._run is None:
                    self._run = _Run(self._settings, self._writer, self._scale, self._full_stances)
                self._run.feed(rows.rows(slice(begin, end)))
        self._last_ns = int(rows.stamps_ns[-1])


class _Run:
    """Rows without a gap between them. Row numbers count from the first row of the run."""

    def __init__(
        self, settings: TransitionSettings, writer: StepWriter, scale: Scale, full_stances: deque[float]
    ) -> None:
        self._settings = settings
        self._writer = writer
        self._scale = scale
        self._full_stances = full_stances
        self._contact = ContactState()
        self._tracker: SwingTracker | None = None
        self._kept: Recording | None = None
        self._first = 0  # number of the first kept row
        self._seen = 0  # rows whose contact is known
        self._swing: SwingInterval | None = None  # the last one completed, until its step is written
        self._start: int | None = None  # row of its step's start
        self._stood_before = False  # the robot stood still before that step
        self._rest: int | None = None  # row of the last touchdown, or the first row if all feet stood there
        self._rest_ns = 0
        self._standing = False  # it has been standing since then

    def feed(self, rows: Recording) -> None:
        """Process the next rows."""
        self._kept = rows if self._kept is None else concatenate([self._kept, rows])
        # speed at a row needs the row after it
        self._advance(self._first + len(self._kept) - 1)
        stamps = self._kept.stamps_ns
        keep_from = stamps[max(self._seen - self._first - 1, 0)] - round(_KEPT_S * 1e9)
        drop = int(np.searchsorted(stamps, keep_from))
        if drop > 0:
            self._kept = self._kept.rows(slice(drop, None))
            self._first += drop

    def finish(self) -> None:
        """Finish the run: steps that are open are counted as cut off."""
        assert self._kept is not None
        self._advance(self._first + len(self._kept))
        if self._standing:
            self._writer.counts["standing_s"] += (int(self._stamps[-1]) - self._rest_ns) * 1e-9
        open_swing = self._tracker is not None and not self._tracker.full_stance
        self._writer.counts["cut_off"] += (self._swing is not None) + open_swing

    def _advance(self, until: int) -> None:
        """Follow contact up to row ``until``, exclusive."""
        assert self._kept is not None
        if until <= self._seen:
            return
        # one row before and after, for the speed at the first and the last of them
        begin = max(self._seen - 1, self._first)
        block = self._kept.rows(slice(begin - self._first, until - self._first + 1))
        new = slice(self._seen - begin, until - begin)
        load, stamps = load_signal(block, self._scale)[new], block.stamps_ns[new]
        self._writer.counts["recorded_s"] += (int(stamps[-1]) - int(block.stamps_ns[0])) * 1e-9
        if self._tracker is None:
            contact = self._contact.initial(load[0], self._scale)
            self._tracker = SwingTracker(contact, 0)
            self._rest, self._rest_ns = (0 if contact.all() else None), int(stamps[0])
        edges = self._contact.edges(load, stamps, self._seen, scale=self._scale, hold_s=self._settings.hold_s)
        self._seen = until
        for row, leg, down in edges.tolist():
            if not down and self._tracker.full_stance:
                self._notice_standing(row)
            swing = self._tracker.feed(row, leg, bool(down))
            if swing is not None:
                self._complete(swing)
        if self._tracker.full_stance and self._contact.settled:
            self._notice_standing(until - 1)

    def _complete(self, swing: SwingInterval) -> None:
        """A pair has landed: the step before, if open, ended before it lifted; its own began there."""
        settings, stumble, start = self._settings, swing.stumble, None
        stood = self._standing
        if swing.lift < self._first or self._ns(swing.land) - self._ns(swing.lift) > settings.max_step_s * 1e9:
            stumble = stumble or "step_time"
            self._drop("step_time")
        elif self._rest is not None:
            full_stance = (self._ns(swing.lift) - self._rest_ns) * 1e-9
            if full_stance < -settings.overlap_s:
                stumble = stumble or "no_full_stance"
                self._drop("no_full_stance")
            else:
                boundary = swing.lift - 1 if swing.lift > self._rest else (swing.lift + self._rest) // 2
                self._write(boundary)
                start = boundary
                if settings.instant == "touchdown":
                    start = self._row_before(swing.lift, self._full_stance_s) if stood else self._rest
                if stood:
                    self._writer.counts["standing_s"] += full_stance
                elif full_stance > 0:
                    self._full_stances.append(full_stance)
        self._rest, self._rest_ns, self._standing = swing.land, self._ns(swing.land), False
        if stumble == "cut_off" or (start is None and not stumble):
            self._writer.counts["cut_off"] += 1
        elif stumble or start is None:
            self._writer.stumble(stumble)
        else:
            self._swing, self._start, self._stood_before = swing, start, stood
            if settings.instant == "touchdown":
                self._write(swing.land)

    def _notice_standing(self, row: int) -> None:
        """All feet stand at ``row``: after a while the robot stands, and its last step ended a full stance after it."""
        if self._rest is None or self._standing or (self._ns(row) - self._rest_ns) * 1e-9 <= self._settings.standing_s:
            return
        self._standing = True
        after = self._rest_ns + round(self._full_stance_s * 1e9)
        self._write(self._first + int(np.searchsorted(self._stamps, after)))

    def _write(self, end: int) -> None:
        """Write the open swing's step, which ends at row ``end``."""
        if self._swing is None or self._start is None:
            return
        assert self._kept is not None
        start_state, end_state = states(self._kept, [self._start - self._first, end - self._first])
        # of the swing alone: the next command is sent a little before, or after, the instant at which it is acted on
        reference, changed = self._reference(self._swing.lift, self._swing.land)
        standing = None
        if self._stood_before:
            before = self._row_before(self._start, self._writer.step_s)
            (still,) = states(self._kept, [before - self._first])
            standing = (still.velocity, self._reference(before, self._start)[0])
        self._writer.counts["command_changes"] += changed
        self._writer.add(start_state, end_state, pair=self._swing.pair, reference=reference, standing=standing)
        self._swing = None

    def _drop(self, reason: str) -> None:
        if self._swing is not None:
            self._writer.stumble(reason)
            self._swing = None

    def _reference(self, start: int, end: int) -> tuple[Array, bool]:
        """Time mean of the command from row ``start`` to row ``end``, and whether it changed on the way."""
        assert self._kept is not None
        command = self._kept.command[start - self._first : max(end, start + 1) - self._first]
        if (command == command[0]).all():
            return command[0].copy(), False
        seconds = np.diff(self._stamps[start - self._first : end - self._first + 1])
        return (command * seconds[:, None]).sum(axis=0) / seconds.sum(), True

    @property
    def _stamps(self) -> NDArray[np.int64]:
        assert self._kept is not None
        return self._kept.stamps_ns

    @property
    def _full_stance_s(self) -> float:
        return median(self._full_stances) if self._full_stances else 0.08

    def _ns(self, row: int) -> int:
        return int(self._stamps[row - self._first])

    def _row_before(self, row: int, seconds: float) -> int:
        """The last row at least ``seconds`` before ``row``, or the first one kept."""
        stamps = self._stamps
        before = self._ns(row) - round(seconds * 1e9)
        return self._first + max(int(np.searchsorted(stamps, before, side="right")) - 1, 0)
