"""The common form of every source of motion, simulated or real, from which transitions are cut."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Instant = Literal["touchdown", "full_stance_end"]


@dataclass(frozen=True, eq=False)
class Recording:
    """A stretch of a robot's motion on one clock: rows in time order, all signals at the same stamps.

    A long log is a sequence of recordings. ``events`` recordings have one row per step instant (a log that the robot
    has already cut into steps); the others are sampled at a steady rate.

    Attributes:
        name: its source (name of a file or an episode).
        stamps_ns: (n,) native stamps, strictly increasing [ns].
        position_world: (n, 3) CoM (the trunk origin as the robot reports it), world frame [m].
        orientation: (n, 4) base to world quaternion, w, x, y, z, unit length.
        velocity_base: (n, 3) CoM velocity, base frame [m/s].
        yaw_rate: (n,) base frame [rad/s].
        command: (n, 3) the velocity command in force *from* this row on: vx, vy [m/s], yaw rate [rad/s].
        feet_base: (n, 4, 3) feet relative to the CoM, base frame [m].
        contact_force: (n, 4) magnitude or vertical force of each foot; None where there is no contact signal. The
            unit is the robot's own; contact detection scales it to the recording.
        swing_pair: (n,) for ``events`` only: index into TROT_PAIRS of the pair that has just swung, -1 where
            the log does not say; None otherwise.
    """

    name: str
    stamps_ns: NDArray[np.int64]
    position_world: Array
    orientation: Array
    velocity_base: Array
    yaw_rate: Array
    command: Array
    feet_base: Array
    contact_force: Array | None = None
    swing_pair: NDArray[np.int8] | None = None

    @property
    def events(self) -> bool:
        """Whether the rows are step instants."""
        return self.swing_pair is not None

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def rows(self, index: slice | NDArray[np.intp]) -> Recording:
        """Return the recording restricted to some rows."""
        changes: dict[str, Any] = {
            field.name: value[index]
            for field in fields(self)
            if field.name != "name" and (value := getattr(self, field.name)) is not None
        }
        return replace(self, **changes)


def concatenate(parts: list[Recording]) -> Recording:
    """Join consecutive stretches of one log."""
    first = parts[0]
    changes: dict[str, Any] = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts])
        for field in fields(first)
        if field.name != "name" and getattr(first, field.name) is not None
    }
    return replace(first, **changes)
