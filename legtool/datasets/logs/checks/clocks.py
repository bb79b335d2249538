"""Stamps: how densely streams are sampled, what was left out of them, and whether they share one clock."""

from __future__ import annotations

from collections.abc import Mapping

from legtool.datasets.logs.checks.finding import Finding
from legtool.datasets.logs.facts import LogFacts, StreamFacts, TopicClock

#: A step must hold at least this many samples: fewer cannot time it, or time it badly.
FEWEST_IN_STEP, FEW_IN_STEP = 5, 8
#: Duration of a step where none was seen [s].
STEP_S = 0.3
#: Topics' clocks may differ by this much [s]: what is more is told, or refused. Odometry that takes its time to be
#: computed has stamps that lie behind its logging, too, and they are right.
DOUBTFUL_S, WRONG_S = 0.03, 0.2
#: Shares of samples with repeated stamps, and of lost samples, that are told and that are refused.
REPEATED, MANY_REPEATED = 0.005, 0.05
LOST, MANY_LOST = 0.05, 0.3
#: A stream that lacks in more than this share of the rows is told.
MISSING = 0.05


def check_sampling(facts: LogFacts, *, held: frozenset[str], events: bool, step_s: float | None) -> list[Finding]:
    """Judge how streams are sampled.

    Args:
        facts: of the log.
        held: streams that are held and not interpolated.
        events: whether rows are step instants.
        step_s: usual duration of a step; None if no steps were found.
    """
    found: list[Finding] = []
    for name, stream in facts.streams.items():
        if stream.count < 2:
            continue
        found += _stamps(name, stream, events=events)
        if not found and not events and name not in held:
            found += _density(name, stream, step_s or STEP_S)
        found += _losses(name, stream, facts)
    return found


def _stamps(name: str, stream: StreamFacts, *, events: bool) -> list[Finding]:
    share = stream.repeated / (stream.count + stream.repeated)
    if share > REPEATED:
        text = f"{stream.label}: {100 * share:.0f} % of its samples repeat an earlier stamp and were left out"
        cause = "are stamps rounded, such as to two decimals? record them with more"
        if stream.longest_ns > 10**9:
            cause = (
                f"stamps are then {stream.longest_ns / 1e9:.4g} s apart: are they float32? record them as float64 or ns"
            )
        return [Finding(name, "refuse" if share > MANY_REPEATED else "warn", f"{text}; {cause}")]
    period, (shortest, longest) = stream.period_s, (5e-3, 20.0) if events else (2e-4, 2.0)
    if period > longest and name == "position":
        text = f"{stream.label}: samples are {period:.4g} s apart; is the time in ms or finer? set stamp_unit"
        return [Finding(name, "refuse", text)]
    if 0 < period < shortest and name == "position":
        text = f"{stream.label}: samples are {period * 1e3:.3g} ms apart; is the time in s or coarser? set stamp_unit"
        return [Finding(name, "refuse", text)]
    return []


def _density(name: str, stream: StreamFacts, step_s: float) -> list[Finding]:
    period = stream.period_s
    if period * FEW_IN_STEP <= step_s:
        return []
    text = f"{stream.label}: samples are {period * 1e3:.0f} ms apart, a step takes {step_s:.2f} s"
    if period * FEWEST_IN_STEP > step_s:
        advice = " or leave contact out of the topics" if name.startswith("contact") else ""
        least = FEW_IN_STEP / step_s
        return [Finding(name, "refuse", f"{text}: too sparse to time it; record it at {least:.0f} Hz or more{advice}")]
    return [Finding(name, "warn", f"{text}: instants of steps are off by up to {period * 5e2:.0f} ms")]


def _losses(name: str, stream: StreamFacts, facts: LogFacts) -> list[Finding]:
    found: list[Finding] = []
    share = stream.lost / (stream.count + stream.lost)
    if share > LOST:
        text = f"{stream.label}: {100 * share:.0f} % of its samples hold no value (not a number, or length 0)"
        level, advice = ("refuse", "check its field") if share > MANY_LOST else ("warn", "these were left out")
        found.append(Finding(name, "refuse" if level == "refuse" else "warn", f"{text}; {advice}"))
    rows = facts.streams["position"].count
    period = facts.streams["position"].period_s
    if stream.stale * period > 1.0:
        text = (
            f"{stream.label}: came every {stream.period_s * 1e3:.0f} ms and stopped; {stream.stale} rows "
            f"({stream.stale * period:.1f} s) without it were left out; if it is sent on change alone, set "
            f"{name}: {{max_age_s: 1e6}}"
        )
        found.append(Finding(name, "warn", text))
    missing = stream.missing - stream.stale
    if rows and missing > MISSING * rows and missing * period > 1.0:
        text = f"{stream.label}: lacks in {missing} of {rows} rows ({missing * period:.1f} s), which were left out"
        found.append(Finding(name, "warn", text))
    return found


def check_clocks(clocks: Mapping[str, TopicClock], *, clock_topic: str | None) -> list[Finding]:
    """Compare header stamps with the time of logging, topic by topic: two computers' clocks differ.

    Args:
        clocks: by topic.
        clock_topic: the topic of the position, which the others are compared with.
    """
    offsets = {name: clock.offset_s for name, clock in clocks.items() if clock.own and clock.offset_s is not None}
    bare = [name for name, clock in clocks.items() if not clock.own]
    if not offsets:
        return []
    base = clock_topic if clock_topic in offsets else min(offsets)
    found: list[Finding] = []
    for name in bare:
        # A topic without header has the time of logging: the others' delays, and their clock's error, stand against it.
        found += _apart(name, "has the time of logging", base, offsets[base])
    for name, offset in offsets.items():
        found += _apart(name, f"header stamps are {offset:+.3g} s off the log's time", base, offsets[base] - offset)
    return found


def _apart(name: str, what: str, base: str, apart: float) -> list[Finding]:
    if abs(apart) <= DOUBTFUL_S:
        return []
    text = (
        f"topic {name}: {what}, those of {base} are {apart:+.3g} s beside them; if these are two computers' clocks, "
        "set stamps: log for both"
    )
    return [Finding(name, "refuse" if abs(apart) > WRONG_S else "warn", text)]
