"""Bring streams of different rates onto one clock by their stamps, in bounded memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool.datasets.logs.signals import Array, Samples, Stamps

#: Rows younger than this are held back, so that samples stamped before but logged after them have arrived [ns].
SETTLE_NS = 1_000_000_000
#: A stream that is silent for longer than this is no longer waited for [ns].
PATIENCE_NS = 10_000_000_000


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
    is copied exactly. A held stream (the command) keeps its last value. A row for which a stream has no value is left
    out and counted in ``missing``.
    """

    def __init__(self, labels: Mapping[str, str], *, clock: str, held: frozenset[str], max_gap_ns: int) -> None:
        self.labels, self.clock, self.held, self.max_gap_ns = labels, clock, held, max_gap_ns
        self.kept: dict[str, Samples | None] = dict.fromkeys(labels)
        self.spans: dict[str, tuple[int, int, int]] = {}
        self.missing = dict.fromkeys(labels, 0)
        self.count = 0

    def push(self, batch: Mapping[str, Samples], *, final: bool = False) -> Rows | None:
        """Add samples, in time order within each stream, and return the rows that are complete.

        Args:
            batch: samples by stream; a stream may be absent.
            final: whether these are the last samples, so that no row is held back any longer.

        Returns:
            The rows, or None if there are none.
        """
        for name, samples in batch.items():
            self._keep(name, samples)
        clock = self.kept[self.clock]
        if clock is None:
            return None
        ready = len(clock.stamps_ns) if final else self._settled(clock.stamps_ns)
        if not ready:
            return None
        rows = self._rows(clock.stamps_ns[:ready])
        self._forget(int(clock.stamps_ns[ready - 1]), ready)
        return rows if len(rows) else None

    def explain(self) -> str:
        """Explain why there are no rows, by the stream that is missing in most of them."""
        name = max(self.missing, key=lambda key: self.missing[key])
        if self.clock not in self.spans:
            return f"{self.labels[self.clock]}: holds no samples, and it is the clock of all others"
        if name not in self.spans:
            return f"{self.labels[name]}: holds no samples"
        first, last, count = self.spans[name]
        start, end, _ = self.spans[self.clock]
        if last < start or first > end:
            return (
                f"{self.labels[name]}: spans {first / 1e9:.3f} to {last / 1e9:.3f} s, {self.labels[self.clock]} spans "
                f"{start / 1e9:.3f} to {end / 1e9:.3f} s; expected them to overlap (do they share one clock?)"
            )
        period = (last - first) / max(count - 1, 1) / 1e6
        return (
            f"{self.labels[name]}: samples are {period:.1f} ms apart on average, expected at most max_gap_s = "
            f"{self.max_gap_ns / 1e6:.0f} ms; raise max_gap_s in the topics' YAML if such gaps are intended"
        )

    def _keep(self, name: str, samples: Samples) -> None:
        at = samples.stamps_ns
        if not len(at):
            return
        start, previous, count = self.spans.get(name, (int(at[0]), int(at[0]) - 1, 0))
        fresh = np.diff(at, prepend=np.int64(previous)) > 0  # a repeated stamp adds nothing
        if not fresh.all():
            samples = Samples(at[fresh], samples.values[fresh])
        self.spans[name] = (start, max(int(at[-1]), previous), count + len(samples.stamps_ns))
        kept = self.kept[name]
        if kept is not None:
            samples = Samples(
                np.concatenate([kept.stamps_ns, samples.stamps_ns]), np.concatenate([kept.values, samples.values])
            )
        self.kept[name] = samples if len(samples.stamps_ns) else None

    def _settled(self, stamps: Stamps) -> int:
        newest = int(stamps[-1])
        sampled = [span[1] for name, span in self.spans.items() if name not in self.held]
        waiting = any(name not in self.spans for name in self.labels if name not in self.held)
        limit = newest - PATIENCE_NS if waiting else max(min(sampled), newest - PATIENCE_NS)
        return int(np.searchsorted(stamps, min(limit, newest - SETTLE_NS), side="right"))

    def _rows(self, stamps: Stamps) -> Rows:
        ok = np.ones(len(stamps), dtype=np.bool_)
        values: dict[str, Array] = {}
        for name in self.labels:
            kept = self.kept[name]
            if kept is None:
                self.missing[name] += len(stamps)
                ok[:] = False
                continue
            if name in self.held:
                values[name], found = _hold(kept, stamps)
            else:
                values[name], found = _interpolate(kept, stamps, self.max_gap_ns, sphere=name == "orientation")
            self.missing[name] += int((~found).sum())
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
            left = Samples(kept.stamps_ns[start:].copy(), kept.values[start:].copy())
            self.kept[name] = left if len(left.stamps_ns) else None


def _hold(samples: Samples, stamps: Stamps) -> tuple[Array, NDArray[np.bool_]]:
    index = np.searchsorted(samples.stamps_ns, stamps, side="right") - 1
    return samples.values[np.maximum(index, 0)], index >= 0


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
