"""Which commands a dataset holds at all: what was never commanded, no model learns."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from legtool.datasets.motion.samples import load_transitions, motion_data
from legtool.errors import DatasetError

#: A command that varies less than this between its 1st and 99th percentile is said to be constant [m/s, rad/s].
CONSTANT = 0.05
_AXES = (("vx", "m/s"), ("vy", "m/s"), ("yaw rate", "rad/s"))


def constant_commands(command: NDArray[np.float64]) -> list[str]:
    """Name the axes of the velocity command that hardly vary.

    Args:
        command: (n, 3) vx, vy [m/s], yaw rate [rad/s], as measured.

    Returns:
        a line for each such axis.
    """
    if not len(command):
        return []
    low, high = np.percentile(command, [1, 99], axis=0)
    return [
        f"command {name} is constant in the data, from {a + 0.0:.2f} to {b + 0.0:.2f} {unit}: models of it say nothing "
        "of other values; collect walks in which it changes"
        for (name, unit), a, b in zip(_AXES, low, high, strict=True)
        if b - a < CONSTANT
    ]


def constant_commands_of(paths: Sequence[Path]) -> list[str]:
    """The same of the usable steps of datasets; nothing of datasets that cannot be read."""
    try:
        return constant_commands(motion_data(load_transitions(paths).table).command)
    except DatasetError:
        return []
