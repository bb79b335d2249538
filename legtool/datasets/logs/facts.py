"""What was noticed while a log was read: how each stream is sampled, what was left out, and whose clock it has."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.int64]


@dataclass
class StreamFacts:
    """One stream of samples.

    Attributes:
        label: its name in messages.
        count: samples that were kept.
        first_ns: stamp of the first [ns]; None before there is one.
        last_ns: stamp of the latest [ns].
        repeated: samples left out because their stamp had been there before, with another value.
        disordered: samples that came before an earlier one and were sorted in.
        late: samples left out because rows of later stamps had been handed on already.
        lost: samples that say that there is no value: not a number, or an orientation of length 0.
        incomplete: rows of a table left out because some of the signal's cells are empty, though not all.
        unstamped: messages whose header stamp is 0, in a topic that is stamped otherwise.
        missing: rows of the clock left out because this stream had no value there.
        stale: rows left out because a command that used to come steadily had not come for too long.
        longest_ns: longest time between two samples [ns].
        medians: median times between samples, one of each piece that was read [ns].
    """

    label: str
    count: int = 0
    first_ns: int | None = None
    last_ns: int = 0
    repeated: int = 0
    disordered: int = 0
    late: int = 0
    lost: int = 0
    incomplete: int = 0
    unstamped: int = 0
    missing: int = 0
    stale: int = 0
    longest_ns: int = 0
    medians: list[float] = field(default_factory=list)

    def add(self, stamps: Stamps) -> None:
        """Take note of new samples, in time order, none older than those before."""
        if not len(stamps):
            return
        steps = np.diff(stamps, prepend=stamps[:1] if self.first_ns is None else np.int64(self.last_ns))
        steps = steps[1:] if self.first_ns is None else steps
        if len(steps):
            self.longest_ns = max(self.longest_ns, int(steps.max()))
            self.medians.append(float(np.median(steps)))
        self.first_ns = int(stamps[0]) if self.first_ns is None else self.first_ns
        self.last_ns = max(self.last_ns, int(stamps[-1]))
        self.count += len(stamps)

    @property
    def period_s(self) -> float:
        """Usual time between two samples [s]; 0 where there are fewer than two."""
        return float(np.median(self.medians)) * 1e-9 if self.medians else 0.0


@dataclass
class TopicClock:
    """The stamps of a topic of a bag.

    Attributes:
        own: whether the stamps of the messages' headers are used.
        offsets_s: header stamp minus time of logging, a median of each piece that was read [s]; empty without header.
    """

    own: bool
    offsets_s: list[float] = field(default_factory=list)

    @property
    def offset_s(self) -> float | None:
        """Header stamp minus time of logging [s]; None without header."""
        return float(np.median(self.offsets_s)) if self.offsets_s else None


@dataclass
class LogFacts:
    """What was noticed while one log was read.

    Attributes:
        streams: by name, such as ``position`` or ``contact/FL``.
        clocks: by topic, for bags.
        gap_ns: rows of the clock further apart than this have a gap between them [ns].
        split: whether stamps may jump.
        alone: rows left out because they have no neighbour to derive a velocity with.
    """

    streams: dict[str, StreamFacts] = field(default_factory=dict)
    clocks: dict[str, TopicClock] = field(default_factory=dict)
    gap_ns: int = 0
    split: bool = False
    alone: int = 0

    def counts(self) -> dict[str, int]:
        """All that was left out or put in order, by what and why; zeros are left out."""
        out: dict[str, int] = {"rows_without_neighbour": self.alone}
        for name, stream in self.streams.items():
            for what in ("repeated", "disordered", "late", "lost", "incomplete", "unstamped"):
                out[f"{what}_{name}"] = getattr(stream, what)
            out[f"rows_without_{name}"] = stream.missing - stream.stale
            out[f"rows_with_stale_{name}"] = stream.stale
        return {name: value for name, value in out.items() if value}
