"""What share of a dataset's swings became no usable step, and why."""

from __future__ import annotations

from collections.abc import Mapping

#: Swings that are lost are told of from this share on.
_TOLD = 0.1
#: So many causes are named, those that cost most.
_NAMED = 3
#: Of each count of swings: what happened, and which settings decide where there is one.
CAUSES = {
    "steps_without_history": "the step before is not usable, or there is none",
    "cut_off": "the recording begins or ends within",
    "stumble_same_pair": "the same pair swung twice",
    "stumble_single_foot": "one foot of the pair swung alone",
    "stumble_extra_foot": "a foot of the other pair swung meanwhile",
    "stumble_short_step": "shorter than transitions.min_step_s, as steps of a fast gait may be",
    "stumble_step_time": "longer than transitions.max_step_s, or off the usual time by transitions.step_time_ratio",
    "stumble_slip": "a stance foot moved farther than transitions.max_slip_m",
    "stumble_no_full_stance": "lifted more than transitions.overlap_s before the other pair landed",
    "stumble_no_pair": "the log names no pair",
}


def lost_steps(counts: Mapping[str, float]) -> list[str]:
    """The share of swings that models cannot use with its main causes, a line; none where it is small.

    Args:
        counts: of a dataset, as :func:`.cut_transitions` gives them.
    """
    lost = {name: int(counts[name]) for name in CAUSES if counts.get(name)}
    missing = sum(lost.values())
    swings = missing + int(counts.get("steps", 0))
    if not swings or missing < _TOLD * swings:
        return []
    most = sorted(lost, key=lambda name: -lost[name])[:_NAMED]
    causes = "; ".join(f"{lost[name]} {CAUSES[name]}" for name in most)
    more = missing - sum(lost[name] for name in most)
    rest = f"; {more} by others" if more else ""
    return [f"  {missing} of {swings} swings ({missing / swings:.0%}) are no usable step: {causes}{rest}"]
