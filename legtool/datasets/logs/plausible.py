"""Detect values that no walking robot has: they indicate a wrong unit, a wrong robot, or two mixed logs."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations

import numpy as np

from legtool.configs.topics import TopicSettings
from legtool.datasets.logs.checks.feet import declared_legs, declared_order, judge_feet
from legtool.datasets.logs.recording import Recording
from legtool.datasets.logs.signals import Array
from legtool.errors import LogError
from legtool_runtime.robot import LEGS, Robot
from legtool_runtime.rotations import rotation_of

#: No legged robot walks, or is told to walk, this fast [m/s].
MAX_SPEED = 10.0
#: Feet may appear at up to this multiple of the reach of a leg before the log is rejected: sensors are not exact.
REACH_MARGIN = 1.15
#: Logged feet and the joints' kinematics may differ by this much [m].
MAX_DISAGREEMENT = 0.05
#: Joint angles do not exceed the first of these, and the largest of them is not below the second [rad].
MAX_ANGLE, MIN_ANGLE = 7.0, 0.1
#: Cosine of the trunk's tilt, which a walking robot never falls below.
UPRIGHT = 0.7
#: Samples of a log are not closer together than this [s].
MIN_PERIOD_S = 2e-4
#: Share of the rows from which on implausible values are not considered chance.
SHARE = 0.05
#: Speeds of fewer rows than this are not judged: one glitch would be a large share of them.
MIN_ROWS = 20


def check_plausible(
    recording: Recording, robot: Robot, labels: Mapping[str, str], topics: TopicSettings, joints: Array | None
) -> None:
    """Reject rows of a log that cannot be this robot's motion in these units.

    Args:
        recording: consecutive rows, with or without gaps.
        robot: the robot that the log should belong to.
        labels: names of the streams, for the message.
        topics: what was declared.
        joints: (n, 12) joint angles [rad], where they are logged.

    Raises:
        LogError: the values are impossible; the message gives the measured value, the limit and what to check.
    """
    if joints is not None and topics.joints is not None:
        _check_angles(joints, topics.joints.unit, labels)
    _check_upright(recording, labels)
    _check_speed(recording, labels)
    _check_reach(recording, robot, labels, declared_legs(topics))
    if joints is None or "feet" not in labels:
        return
    placed = robot.feet(joints)
    apart = np.linalg.norm(placed - recording.feet_base, axis=2).max(axis=1)
    if (apart > MAX_DISAGREEMENT).mean() > SHARE:
        for best in permutations(range(4)):
            other = np.linalg.norm(placed - recording.feet_base[:, list(best)], axis=2).max(axis=1)
            if (other > MAX_DISAGREEMENT).mean() <= SHARE:
                legs = declared_order(declared_legs(topics), best)
                raise LogError(
                    f"{labels['feet']} and {labels['joints']}: feet and joint angles disagree by "
                    f"{np.median(apart):.3f} m (median), and agree in another order of the legs; "
                    f"set feet: {{legs: [{legs}]}}"
                )
        raise LogError(
            f"{labels['feet']} and {labels['joints']}: feet and joint angles disagree by {np.median(apart):.3f} m "
            f"(median) by the kinematics of {robot.name}, expected less than {MAX_DISAGREEMENT} m; check --robot, and "
            "whether two robots' logs are mixed"
        )


def _check_angles(joints: Array, unit: str, labels: Mapping[str, str]) -> None:
    """Knees are always bent, and no joint of a leg turns more than once around."""
    if len(joints) < MIN_ROWS:
        return
    large = float(np.quantile(np.abs(joints).max(axis=1), 0.5))
    if unit == "rad" and large > MAX_ANGLE:
        raise LogError(
            f"{labels['joints']}: angles reach {large:.3g} rad (median), expected at most {MAX_ANGLE:g} rad; are they "
            "in degrees? set joints: {unit: deg}"
        )
    if unit == "deg" and large < MIN_ANGLE:
        raise LogError(
            f"{labels['joints']}: angles reach {large:.3g} rad (median) and knees are bent by more than "
            f"{MIN_ANGLE:g} rad; are they in radians? set joints: {{unit: rad}}"
        )


def _check_upright(recording: Recording, labels: Mapping[str, str]) -> None:
    """A robot that walks stands upright: where it does not, the numbers of its orientation have another order."""
    if len(recording) < MIN_ROWS or "orientation" not in labels:
        return
    up = float(np.median(rotation_of(recording.orientation)[:, 2, 2]))
    if up < UPRIGHT:
        raise LogError(
            f"{labels['orientation']}: the trunk is tilted by {np.degrees(np.arccos(up)):.0f} degrees (median); is the "
            "order of its numbers another (order: wxyz or xyzw), or is it mounted otherwise (mount)?"
        )


def _check_speed(recording: Recording, labels: Mapping[str, str]) -> None:
    if len(recording) < MIN_ROWS:
        return
    steps = np.diff(recording.stamps_ns) * 1e-9
    travelled = np.linalg.norm(np.diff(recording.position_world, axis=0), axis=1)
    found = {
        "position": travelled / steps,
        "velocity": np.linalg.norm(recording.velocity_base, axis=1),
        "command": np.linalg.norm(recording.command[:, :2], axis=1),
    }
    for name, speed in found.items():
        # The fastest tenth: a robot that mostly stands is caught as well, one glitch of a tracker is not.
        if len(speed) and (fast := float(np.quantile(speed, 0.9))) > MAX_SPEED and name in labels:
            if (period := float(np.median(steps))) < MIN_PERIOD_S:
                raise LogError(
                    f"{labels['position']}: samples are {period * 1e3:.3g} ms apart, and speeds {fast:.4g} m/s; is the "
                    "time in a coarser unit (stamp_unit: s)?"
                )
            verb = "is" if name == "command" else "moves"
            raise LogError(
                f"{labels[name]}: {'' if name == 'command' else 'the trunk '}{verb} at {fast:.4g} m/s, expected below "
                f"{MAX_SPEED:g} m/s; is it in millimetres (unit: mm), or are two logs mixed?"
            )


def _check_reach(recording: Recording, robot: Robot, labels: Mapping[str, str], order: tuple[str, ...]) -> None:
    label = labels.get("feet", labels.get("joints", "feet"))
    reach = np.hypot(robot.thigh_length + robot.shank_length, robot.abduction_offset)
    distance = np.linalg.norm(recording.feet_base - robot.hips, axis=2)
    beyond = (distance > REACH_MARGIN * reach).any(axis=1)
    if beyond.mean() <= SHARE:
        return
    leg = int(np.argmax(np.median(distance / reach, axis=0)))
    found = judge_feet(np.median(recording.feet_base, axis=0), robot, label, order=order)
    if found and "order of the legs" in found[0].text:
        raise LogError(found[0].text)
    far = float(np.median(distance[beyond][:, leg]))
    likely = "are they in millimetres (unit: mm)?" if far > 20 * reach[leg] else "check --robot, units and frame"
    raise LogError(
        f"{label}: foot {LEGS[leg]} is {far:.4g} m from its hip, beyond the {reach[leg]:.3f} m reach of {robot.name}'s "
        f"leg; {likely}"
    )
