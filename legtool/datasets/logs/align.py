"""Bring streams of different rates onto one clock by their stamps, in bounded memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool.datasets.logs.facts import LogFacts, StreamFacts
from legtool.datasets.logs.signals import MAX_LATE_NS, Array, Samples, Stamps

#: Rows younger than this are held back, so that samples stamped before but logged after them have arrived [ns].
SETTLE_NS = MAX_LATE_NS
#: A stream that is silent for longer than this is no longer waited for [ns].
PATIENCE_NS = 10_000_000_000
#: The usual time between rows of the clock is known after this much of them [ns].
LISTEN_NS = 500_000_000
#: Rows further apart than this multiple of the usual time have a gap between them, if ``max_gap`` is shorter still.
GAP_RATIO = 1.5
#: A held stream came steadily if this many times in a row no longer than this passed between two samples [ns].
STEADY_SAMPLES, STEADY_NS = 10, 250_000_000
#: What came steadily and then stopped is held no longer than this [ns].
MAX_AGE_NS = 1_000_000_000


@dataclass(frozen=True)
class Rows:
    """Rows of the clock at which every stream has a value: stamps (n,) [ns] and, by stream, values (n, k)."""

    stamps_ns: Stamps
    values: dict[str, Array]

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __getitem__(self, index: slice | NDArray[np.intp]) -> Rows:
        return Rows(self.stamps_ns[index], {name: value[index] for name, value in self.values.items()})


def join(a: Rows, b: Rows) -> Rows:
    """Return rows ``a`` followed by rows ``b``."""
    values = {name: np.concatenate([a.values[name], b.values[name]]) for name in a.values}
    return Rows(np.concatenate([a.stamps_ns, b.stamps_ns]), values)


class Aligner:
    """Collects samples and returns rows of the clock's stream once no earlier sample can still arrive.

    A sampled stream is interpolated linearly between neighbours that are at most ``max_gap`` apart; at equal stamps it
    is copied exactly. A held stream (the command) keeps its last value, unless it came steadily before and stopped.
    A row for which a stream has no value is left out. Samples that come up to a second late are sorted in. All that
    is left out is counted in ``facts``.
    """

    def __init__(
        self,
        labels: Mapping[str, str],
        *,
        clock: str,
        held: frozenset[str],
        max_gap_ns: int,
        max_age_ns: int | None = None,
        facts: LogFacts | None = None,
    ) -> None:
        self.labels, self.clock, self.held, self.max_gap_ns = labels, clock, held, max_gap_ns
        self.max_age_ns = max_age_ns
        self.kept: dict[str, Samples | None] = dict.fromkeys(labels)
        self.facts = LogFacts() if facts is None else facts
        for name, label in labels.items():
            self.facts.streams.setdefault(name, StreamFacts(label))
        self.steady: dict[str, NDArray[np.bool_]] = {}
        self.recent: dict[str, Stamps] = {}
        self.emitted: int | None = None
        self.count = 0
        for stream in self.facts.streams.values():
            stream.first_ns = None  # another session's stamps say nothing of this one's

    def push(self, batch: Mapping[str, Samples] | None, *, final: bool = False) -> Rows | None:
        """Add samples, in about time order within each stream, and return the rows that are complete.

        Args:
            batch: samples by stream; a stream may be absent, or all of them.
            final: whether these are the last samples, so that no row is held back any longer.

        Returns:
            The rows, or None if there are none.
        """
        for name, samples in (batch or {}).items():
            self._keep(name, samples)
        clock = self.kept[self.clock]
        if clock is None:
            return None
        if not self.facts.gap_ns:
            if not final and clock.stamps_ns[-1] - clock.stamps_ns[0] < LISTEN_NS:
                return None
            self.facts.gap_ns = max(self.max_gap_ns, self._usual_gap(clock.stamps_ns))
        ready = len(clock.stamps_ns) if final else self._settled(clock.stamps_ns)
        if not ready:
            return None
        rows = self._rows(clock.stamps_ns[:ready])
        self.emitted = int(clock.stamps_ns[ready - 1])
        self._forget(self.emitted, ready)
        return rows if len(rows) else None

    def explain(self) -> str:
        """Explain why there are no rows, by the stream that is missing in most of them."""
        streams = self.facts.streams
        name = max(streams, key=lambda key: streams[key].missing)
        clock, worst = streams[self.clock], streams[name]
        if clock.first_ns is None:
            return f"{clock.label}: holds no samples, and it is the clock of all others{_why_none(clock)}"
        if worst.first_ns is None:
            return f"{worst.label}: holds no samples{_why_none(worst)}"
        if worst.last_ns < clock.first_ns or worst.first_ns > clock.last_ns:
            return (
                f"{worst.label}: spans {worst.first_ns / 1e9:.3f} to {worst.last_ns / 1e9:.3f} s, {clock.label} spans "
                f"{clock.first_ns / 1e9:.3f} to {clock.last_ns / 1e9:.3f} s; expected them to overlap (do they share "
                "one clock?)"
            )
        period = (worst.last_ns - worst.first_ns) / max(worst.count - 1, 1) / 1e6
        return (
            f"{worst.label}: samples are {period:.1f} ms apart on average, expected at most max_gap_s = "
            f"{self.max_gap_ns / 1e6:.0f} ms; raise max_gap_s in the topics' YAML if such gaps are intended"
        )

    def _keep(self, name: str, samples: Samples) -> None:
        if not len(samples.stamps_ns):
            return
        facts, kept = self.facts.streams[name], self.kept[name]
        if kept is not None:
            at = np.concatenate([kept.stamps_ns, samples.stamps_ns])
            samples = Samples(at, np.concatenate([kept.values, samples.values]))
        before = 0 if kept is None else len(kept.stamps_ns)
        samples = self._in_order(facts, samples, clock=name == self.clock)
        at = samples.stamps_ns
        facts.add(at[np.searchsorted(at, facts.last_ns, "right") :] if facts.first_ns is not None else at)
        if name in self.held and len(at) > before:
            self.steady[name] = self._steady(name, at)
        self.kept[name] = samples if len(at) else None

    def _in_order(self, facts: StreamFacts, samples: Samples, *, clock: bool) -> Samples:
        """Samples by rising stamps, each once; those of the clock that are too late to be rows are left out."""
        steps = np.diff(samples.stamps_ns)
        if len(steps) and steps.min() <= 0:
            if steps.min() < 0:
                facts.disordered += int((samples.stamps_ns < np.maximum.accumulate(samples.stamps_ns)).sum())
                order = np.argsort(samples.stamps_ns, kind="stable")
                samples = Samples(samples.stamps_ns[order], samples.values[order])
            fresh = np.diff(samples.stamps_ns, prepend=samples.stamps_ns[:1] - 1) > 0
            same = (np.diff(samples.values, axis=0) == 0).all(axis=1)  # sent twice: nothing is lost with it
            facts.repeated += int((~fresh[1:] & ~same).sum())
            samples = Samples(samples.stamps_ns[fresh], samples.values[fresh])
        if clock and self.emitted is not None and len(samples.stamps_ns) and samples.stamps_ns[0] <= self.emitted:
            late = int(np.searchsorted(samples.stamps_ns, self.emitted, "right"))
            facts.late += late
            samples = Samples(samples.stamps_ns[late:], samples.values[late:])
        return samples

    def _steady(self, name: str, at: Stamps) -> NDArray[np.bool_]:
        """Whether each of these samples ends a row of samples that came steadily."""
        past = self.recent.get(name, at[:0])
        past = past[past < at[0]]
        whole = np.concatenate([past, at])
        quick = np.concatenate([[False], np.diff(whole) <= STEADY_NS])
        run = np.cumsum(quick)
        back = np.concatenate([np.zeros(STEADY_SAMPLES, dtype=run.dtype), run])[: len(run)]
        return (run - back >= STEADY_SAMPLES)[len(past) :]

    def _usual_gap(self, stamps: Stamps) -> int:
        start = stamps[: int(np.searchsorted(stamps, stamps[0] + LISTEN_NS, "right"))]
        return int(GAP_RATIO * float(np.median(np.diff(start)))) if len(start) > 1 else 0

    def _settled(self, stamps: Stamps) -> int:
        newest = int(stamps[-1])
        streams = {name: stream for name, stream in self.facts.streams.items() if name not in self.held}
        waiting = any(stream.first_ns is None for stream in streams.values())
        latest = min(stream.last_ns for stream in streams.values())
        limit = newest - PATIENCE_NS if waiting else max(latest, newest - PATIENCE_NS)
        return int(np.searchsorted(stamps, min(limit, newest - SETTLE_NS), side="right"))

    def _rows(self, stamps: Stamps) -> Rows:
        ok = np.ones(len(stamps), dtype=np.bool_)
        values: dict[str, Array] = {}
        for name in self.labels:
            kept, facts = self.kept[name], self.facts.streams[name]
            if kept is None:
                facts.missing += len(stamps)
                ok[:] = False
                continue
            if name in self.held:
                values[name], found, stale = _hold(kept, stamps, self.steady[name], self.max_age_ns)
                facts.stale += int(stale.sum())
            else:
                values[name], found = _interpolate(kept, stamps, self.max_gap_ns, sphere=name == "orientation")
            facts.missing += int((~found).sum())
            ok &= found
        if len(values) < len(self.labels):
            return Rows(stamps[:0], {})
        self.count += int(ok.sum())
        rows = Rows(stamps, values)
        return rows if ok.all() else rows[np.flatnonzero(ok)]

    def _forget(self, until: int, ready: int) -> None:
        """Drop what no later row can need: all but the last sample at or before ``until``."""
        for name, kept in self.kept.items():
            if kept is None:
                continue
            start = ready if name == self.clock else max(int(np.searchsorted(kept.stamps_ns, until, "right")) - 1, 0)
            if name in self.held:
                self.recent[name] = kept.stamps_ns[max(start - STEADY_SAMPLES - 1, 0) : start].copy()
                self.steady[name] = self.steady[name][start:]
            left = Samples(kept.stamps_ns[start:].copy(), kept.values[start:].copy())
            self.kept[name] = left if len(left.stamps_ns) else None


def _why_none(stream: StreamFacts) -> str:
    return f" ({stream.lost} samples say that there is no value)" if stream.lost else ""


def _hold(
    samples: Samples, stamps: Stamps, steady: NDArray[np.bool_], max_age_ns: int | None
) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """The last values (n, k), whether there are any, and whether they are too old."""
    index = np.searchsorted(samples.stamps_ns, stamps, side="right") - 1
    last = np.maximum(index, 0)
    age = stamps - samples.stamps_ns[last]
    stale = steady[last] & (age > MAX_AGE_NS) if max_age_ns is None else age > max_age_ns
    stale &= index >= 0
    return samples.values[last], (index >= 0) & ~stale, stale


def _interpolate(samples: Samples, stamps: Stamps, max_gap_ns: int, *, sphere: bool) -> tuple[Array, NDArray[np.bool_]]:
    at, values = samples
    last = len(at) - 1
    right = np.searchsorted(at, stamps, side="left")
    inside = (right <= last) & ((right > 0) | (at[0] == stamps))
    right = np.minimum(right, last)
    exact = at[right] == stamps
    if exact.all():
        return values[right], exact
    left = np.maximum(right - 1, 0)
    gap = at[right] - at[left]
    found = exact | (inside & (gap <= max_gap_ns))
    share = ((stamps - at[left]) / np.maximum(gap, 1))[:, None]
    a, b = values[left], values[right]
    if sphere:
        b = np.where((a * b).sum(axis=1, keepdims=True) < 0, -b, b)
    mixed = a + share * (b - a)
    if sphere:
        mixed /= np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-12)
    return np.where(exact[:, None], values[right], mixed), found
