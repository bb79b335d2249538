"""Gait parameters α of ViTAL's tuple, and what follows from them and the base twist."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.checks import Bounds, within
from legtool_runtime.errors import StateError, shown
from legtool_runtime.robot import Robot
from legtool_runtime.rotations import place

_BOUNDS = {
    "step_length_m": Bounds(0.0, 2.0),
    "step_frequency_hz": Bounds(0.1, 10.0),
    "duty_factor": Bounds(0.1, 0.95),
    "time_to_touchdown_s": Bounds(0.0, 10.0),
}


@dataclass(frozen=True)
class Gait:
    """α: what a step is like, and how far it has come.

    Attributes:
        step_length_m: way of a foot from one foothold to the next.
        step_frequency_hz: steps of one leg per second.
        duty_factor: share of the cycle in stance.
        time_to_touchdown_s: until the leg touches down; more than a swing while it still stands.
    """

    step_length_m: float = 0.2
    step_frequency_hz: float = 1.4
    duty_factor: float = 0.55
    time_to_touchdown_s: float = 10.0

    def __post_init__(self) -> None:
        within("gait", self, _BOUNDS, StateError)

    @property
    def swing_s(self) -> float:
        """Duration of the swing [s]."""
        return (1.0 - self.duty_factor) / self.step_frequency_hz

    @property
    def stance_s(self) -> float:
        """Duration of the stance [s]."""
        return self.duty_factor / self.step_frequency_hz

    @property
    def swing_phase(self) -> float:
        """Share of the swing that is over, 0 while the leg still stands."""
        return min(max(1.0 - self.time_to_touchdown_s / self.swing_s, 0.0), 1.0)


def checked_twist(base_twist: Sequence[float] | NDArray[np.floating]) -> tuple[float, ...]:
    """A base twist as six plain numbers.

    Raises:
        StateError: it is not six finite numbers within 10 m/s and 10 rad/s.
    """
    try:
        values = base_twist.tolist() if isinstance(base_twist, np.ndarray) else base_twist
        twist = tuple([float(value) for value in values])
    except (TypeError, ValueError, OverflowError) as problem:
        raise StateError(f"base twist {shown(base_twist)}: expected six numbers") from problem
    if len(twist) != 6 or not all([abs(value) <= 10.0 for value in twist]):
        raise StateError(f"base twist {shown(twist)}: expected six numbers within ±10 m/s and ±10 rad/s")
    return twist


def hip_velocity(
    robot: Robot, leg: int, base_twist: Sequence[float], *, roll: float = 0.0, pitch: float = 0.0
) -> tuple[float, float, float]:
    """Velocity of a leg's hip [m/s] under a base twist (6,) in the horizontal frame: v + ω × Ry(pitch) Rx(roll) p_hip.

    The twist is that of the trunk's origin, taken as it is, see :func:`checked_twist`; a tilted trunk carries its hips
    elsewhere from that origin, and so they move otherwise when it turns.
    """
    vx, vy, vz, wx, wy, wz = base_twist
    x, y, z = robot.hips[leg].tolist()
    if roll != 0.0 or pitch != 0.0:
        x, y, z = place((x, y, z), roll, pitch, 0.0).tolist()
    return vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x


def nominal_foothold(robot: Robot, leg: int, velocity: tuple[float, float, float], gait: Gait) -> tuple[float, float]:
    """Nominal foothold from below the hip at touchdown [m]: the foot at rest, and half a stance of the hip's motion."""
    half = 0.5 * gait.stance_s
    rest = robot.stance[leg] - robot.hips[leg]
    return float(rest[0]) + half * velocity[0], float(rest[1]) + half * velocity[1]
