"""Recordings on uneven ground, in the frames in which planners plan there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from legtool.datasets.logs.recording import Recording
from legtool_runtime.motion.features import as_on_level_ground
from legtool_runtime.rotations import quaternion_about_z, rotation_of, yaw_of


def as_on_level(recording: Recording) -> Recording:
    """The recording in the frames that the planner plans in: the horizontal one where the ground is uneven."""
    rotation = rotation_of(recording.orientation)
    feet, level = as_on_level_ground(recording.feet_base, rotation)
    heading = quaternion_about_z(yaw_of(rotation))
    changed = (level != rotation).any(axis=(1, 2))
    return replace(recording, feet_base=feet, orientation=np.where(changed[:, None], heading, recording.orientation))
