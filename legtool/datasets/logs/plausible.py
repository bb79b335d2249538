"""Detect values that no walking robot has: they indicate a wrong unit, a wrong robot, or two mixed logs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from legtool.datasets.logs.recording import Recording
from legtool.datasets.logs.signals import Array
from legtool.errors import LogError
from legtool_runtime.robot import LEGS, Robot

#: No legged robot walks, or is told to walk, this fast [m/s].
MAX_SPEED = 10.0
#: Feet may appear at up to this multiple of the reach of a leg before the log is rejected: sensors are not exact.
REACH_MARGIN = 1.15
#: Logged feet and the joints' kinematics may differ by this much [m].
MAX_DISAGREEMENT = 0.05
#: Share of the rows from which on implausible values are not considered chance.
SHARE = 0.05
#: Speeds of fewer rows than this are not judged: one glitch would be a large share of them.
MIN_ROWS = 20


def check_plausible(recording: Recording, robot: Robot, labels: Mapping[str, str], joint_feet: Array | None) -> None:
    """Reject rows of a log that cannot be this robot's motion in these units.

    Args:
        recording: consecutive rows, with or without gaps.
        robot: the robot that the log should belong to.
        labels: names of the streams, for the message.
        joint_feet: (n, 4, 3) feet by kinematics from the joints, base frame [m], where feet are logged as well.

    Raises:
        LogError: the values are impossible; the message gives the measured value, the limit and what to check.
    """
    _check_speed(recording, labels)
    _check_reach(recording, robot, labels)
    if joint_feet is None:
        return
    apart = np.linalg.norm(joint_feet - recording.feet_base, axis=2).max(axis=1)
    if (apart > MAX_DISAGREEMENT).mean() > SHARE:
        raise LogError(
            f"{labels['feet']} and {labels['joints']}: feet and joint angles disagree by {np.median(apart):.3f} m "
            f"(median) by the kinematics of {robot.name}, expected less than {MAX_DISAGREEMENT} m; check --robot, and "
            "whether two robots' logs are mixed"
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
            verb = "is" if name == "command" else "moves"
            raise LogError(
                f"{labels[name]}: {'' if name == 'command' else 'the trunk '}{verb} at {fast:.4g} m/s, expected below "
                f"{MAX_SPEED:g} m/s; is it in millimetres (unit: mm), or are two logs mixed?"
            )


def _check_reach(recording: Recording, robot: Robot, labels: Mapping[str, str]) -> None:
    label = labels.get("feet", labels.get("joints", "feet"))
    reach = np.hypot(robot.thigh_length + robot.shank_length, robot.abduction_offset)
    distance = np.linalg.norm(recording.feet_base - robot.hips, axis=2)
    beyond = (distance > REACH_MARGIN * reach).any(axis=1)
    if beyond.mean() <= SHARE:
        return
    leg = int(np.argmax(np.median(distance / reach, axis=0)))
    far = float(np.median(distance[beyond][:, leg]))
    likely = "are they in millimetres (unit: mm)?" if far > 20 * reach[leg] else "check --robot, units and frame"
    raise LogError(
        f"{label}: foot {LEGS[leg]} is {far:.4g} m from its hip, beyond the {reach[leg]:.3f} m reach of {robot.name}'s "
        f"leg; {likely}"
    )
