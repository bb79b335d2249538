"""Recognise the twelve joints of a robot by the usual names of legs and joints."""

from __future__ import annotations

import re

from legtool_runtime.robot import JOINTS, LEGS

_LEG_NAMES = {
    "FL": ("fl", "lf", "front_left", "left_front"),
    "FR": ("fr", "rf", "front_right", "right_front"),
    "RL": ("rl", "lh", "hl", "lr", "rear_left", "hind_left", "back_left", "left_hind", "left_rear"),
    "RR": ("rr", "rh", "hr", "rear_right", "hind_right", "back_right", "right_hind", "right_rear"),
}
_JOINT_NAMES = {
    "hip": ("haa", "abd", "hipx", "hip_x", "hx", "hip"),
    "thigh": ("hfe", "thigh", "hipy", "hip_y", "hy", "upper"),
    "knee": ("kfe", "knee", "calf", "shank", "kn", "lower"),
}


def joint_order(names: list[str], wanted: tuple[str, ...]) -> list[int] | None:
    """Find the 12 joints among the names in a message.

    Args:
        names: names in the order of the message.
        wanted: the names to look for; if empty, joints are recognised by the usual names of legs and joints.

    Returns:
        12 indices, by leg and joint; None if a joint is missing or ambiguous.
    """
    if wanted:
        return [names.index(name) for name in wanted] if all(name in names for name in wanted) else None
    found: dict[tuple[str, str], int] = {}
    for index, name in enumerate(names):
        key = _recognise(name)
        if key is not None and found.setdefault(key, index) != index:
            return None
    order = [found.get((leg, joint)) for leg in LEGS for joint in JOINTS]
    return None if None in order else [index for index in order if index is not None]


def _recognise(name: str) -> tuple[str, str] | None:
    low = name.lower().rsplit("/", 1)[-1]
    found = [
        (leg, token) for leg, tokens in _LEG_NAMES.items() for token in tokens if re.match(token + r"(?![a-z])", low)
    ]
    if not found:
        return None
    leg, token = max(found, key=lambda pair: len(pair[1]))
    rest = low[len(token) :]
    # The more specific names come first: hip_y is a thigh joint, although its name contains "hip".
    for joint in ("thigh", "knee", "hip"):
        if any(token in rest for token in _JOINT_NAMES[joint]):
            return leg, joint
    return None
