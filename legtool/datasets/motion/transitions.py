"""Full-stance transitions: state, command and resulting motion, step by step (motion paper, section III).

A row is one step. Its state is taken at an *instant* t, its targets at the next one. The instant is ``touchdown``, when
the pair that swung has landed, or ``full_stance_end``, just before the next pair lifts, which is when the planner acts.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pyarrow as pa

from legtool.configs.motion import TransitionSettings
from legtool.datasets.logs.recording import Recording
from legtool.datasets.motion.cutting import EventCutter, SampledCutter
from legtool.datasets.motion.steps import StepWriter
from legtool.errors import DatasetError, LogError

#: A log with fewer steps than this is not considered a trot.
FEWEST_STEPS = 10
#: What is said of steps whose states are taken at touchdown, wherever such steps or models of them are made.
TOUCHDOWN = (
    "states at touchdown: whoever plans by models of them plans once a step, as a pair lands, as eval planner does; on "
    "the robot StepTracker(instant='touchdown')"
)


def cut_transitions(
    chunks: Iterable[Recording], settings: TransitionSettings, *, episode: int | str = 0
) -> tuple[pa.Table, dict[str, float]]:
    """Cut a recording into steps, in memory bounded by the chunks' size and the number of steps.

    Args:
        chunks: consecutive stretches of one recording; the result does not depend on where it is divided.
        settings: thresholds and limits.
        episode: number or name; evaluation never splits an episode between training and test.

    Returns:
        A table with SCHEMA, one row per step, whose ``status`` tells which rows models may use (unknown values are
        null); and the counts: usable ``steps``, ``segments`` of consecutive steps, ``steps_without_history``,
        ``stumble_*`` by reason, ``gaps``, ``cut_off`` by the ends of the recording, ``standing_s``, ``recorded_s``,
        ``rows``, and ``command_changes`` within a swing.

    Raises:
        LogError: stamps go backwards, or chunks of different kinds are mixed.
    """
    writer: StepWriter | None = None
    cutter: EventCutter | SampledCutter | None = None
    events = False
    last_ns: int | None = None
    for chunk in chunks:
        if len(chunk) == 0:
            continue
        if writer is None or cutter is None:
            writer = StepWriter(settings, recording=chunk.name, episode=str(episode))
            events = chunk.events
            cutter = (EventCutter if events else SampledCutter)(settings, writer)
        if chunk.events != events:
            raise LogError(f"{chunk.name}: step events and sampled rows are mixed in one recording")
        stamps = chunk.stamps_ns if last_ns is None else np.concatenate([[last_ns], chunk.stamps_ns])
        if (np.diff(stamps) <= 0).any():
            at = int(stamps[int(np.argmax(np.diff(stamps) <= 0)) + 1])
            raise LogError(f"{chunk.name}: stamps go backwards or repeat at {at} ns; sort or repair the log")
        last_ns = int(stamps[-1])
        writer.counts["rows"] += len(chunk)
        cutter.feed(chunk)
    if writer is None or cutter is None:
        return StepWriter(settings, recording="", episode=str(episode)).table()
    cutter.finish()
    return writer.table()


def check_enough(counts: Mapping[str, float], *, fewest: int = FEWEST_STEPS) -> None:
    """Reject a dataset that is not a trot.

    Raises:
        DatasetError: there are too few usable steps; the message says what was seen instead.
    """
    steps = int(counts.get("steps", 0))
    if steps >= fewest:
        return
    seen = [f"{value:g} {name.replace('_', ' ')}" for name, value in counts.items() if value and name != "steps"]
    raise DatasetError(
        f"only {steps} regular steps were found, expected at least {fewest} of a trot (two diagonal feet swinging "
        f"together, then the other two); seen: {', '.join(seen) or 'no rows'}; is this another gait, "
        "another robot, another order of legs, or are its signals on different clocks?"
    )
