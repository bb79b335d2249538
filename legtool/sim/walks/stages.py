"""What a planner that works in stages did on a walk: times of each stage, counts, and what kept it from going on."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class StageLog:
    """Notes of a walk.

    Attributes:
        times_s: of every answer of each stage, by its name.
        counts: of what happened, such as ``replans`` and ``aborts``.
        blocked_by: the stage that has no answer at the moment; empty while all have.
        reason: why that has none, in one line.
        told: what a monitor told of: when [s], the event, and the stage that it speaks against, empty for none.
    """

    times_s: dict[str, list[float]] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    blocked_by: str = ""
    reason: str = ""
    told: list[tuple[float, str, str]] = field(default_factory=list)

    def took(self, stage: str, time_s: float) -> None:
        """One more answer of a stage."""
        self.times_s.setdefault(stage, []).append(time_s)

    def count(self, what: str, number: int = 1) -> None:
        """So many more."""
        self.counts[what] = self.counts.get(what, 0) + number

    def cause(self, since_s: float) -> str:
        """The stage that the first event from a time on speaks against; empty where none speaks against any."""
        return next((stage for when, _, stage in self.told if stage and when >= since_s), "")
