"""What ends a tracked walk: measurements that cannot be used, a clock that stands, torques that saturate for long."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.errors import TrackingError
from legtool_runtime.robot import JOINTS, LEGS
from legtool_runtime.tracking.preview import PreviewSolution
from legtool_runtime.tracking.whole_body import SOLVED, Answer

Array = NDArray[np.float64]

#: The longest that one tick may take, and the share of its limit at which a torque counts as saturated.
_LONGEST_S, _SATURATED = 0.1, 0.999
#: What a tick is taken to last until a clock has told [s].
_TICK_S = 0.0025


@dataclass(frozen=True)
class WatchLimits:
    """How long what is wrong may last before the robot comes to a stand [s].

    Attributes:
        blind_s: without a usable state.
        clock_s: with a clock that stands still, by the ticks that go on.
        saturated_s: with the torque of one joint at its limit; time below it counts against it.
        unsolved_s: without a solution of whole-body control or preview.
        search_s: a foot that searches for the ground.
        tilt: largest angle of the body's vertical axis off the world's [rad].
    """

    blind_s: float = 0.05
    clock_s: float = 0.05
    saturated_s: float = 1.0
    unsolved_s: float = 0.2
    search_s: float = 1.0
    tilt: float = 0.9

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) and value > 0 for value in vars(self).values()):
            raise TrackingError(f"watch: limits {self}, expected positive numbers")


class Watch:
    """Counts what goes wrong, from tick to tick.

    Attributes:
        limits: of it.
        usable: whether the last measurement can be controlled by.
    """

    def __init__(self, torque_limit: Array, limits: WatchLimits | None = None) -> None:
        """Take the torque limits (4, 3) [Nm], and how long what is wrong may last."""
        self.limits = limits or WatchLimits()
        self._most = _SATURATED * np.asarray(torque_limit, dtype=np.float64).ravel()
        self._saturated_s = np.zeros(12)
        self.usable = True
        self._time_s, self._tick_s = math.nan, _TICK_S
        self._blind_s = self._still_s = self._unsolved_s = self._unplanned_s = 0.0

    def tick(self, state: Iterable[Array], time_s: float) -> tuple[float, str]:
        """Look at what was measured.

        Returns:
            how long the tick was [s], and what is wrong for too long; empty if nothing is.
        """
        dt, wrong = time_s - self._time_s, ""
        if 0.0 < dt <= _LONGEST_S:
            self._still_s, self._tick_s = 0.0, dt
        else:  # a tick has passed all the same
            if dt > _LONGEST_S:
                wrong = f"the clock jumped by {dt:.2f} s"
            elif math.isfinite(self._time_s):
                self._still_s += self._tick_s
            dt = self._tick_s
        if math.isfinite(time_s):
            self._time_s = time_s
        if self._still_s > self.limits.clock_s:
            wrong = f"the clock stands still at {self._time_s:g} s"
        self.usable = _usable(state)
        self._blind_s = 0.0 if self.usable else self._blind_s + dt
        if self._blind_s > self.limits.blind_s:
            wrong = "the measured state is not finite, or its orientation no unit quaternion"
        return dt, wrong

    def judge(self, answer: Answer, preview: PreviewSolution | None, rotation: Array, dt: float) -> str:
        """Look at what was decided; what is wrong for too long, empty if nothing is."""
        worst = _saturate(answer.torques, self._most, dt, self._saturated_s)
        self._unsolved_s = 0.0 if answer.status == SOLVED else self._unsolved_s + dt
        self._unplanned_s = 0.0 if preview is None or preview.solved else self._unplanned_s + dt
        limits = self.limits
        if self._saturated_s[worst] > limits.saturated_s:
            leg, joint = divmod(worst, 3)
            return f"the torque of {LEGS[leg]} {JOINTS[joint]} has been at its limit for {limits.saturated_s:g} s"
        if self._unsolved_s > limits.unsolved_s:
            return f"whole-body control found no solution for {limits.unsolved_s:g} s"
        if self._unplanned_s > limits.unsolved_s:
            return f"the preview found no solution for {limits.unsolved_s:g} s"
        if rotation[2, 2] < math.cos(limits.tilt):
            return f"the body leans by more than {limits.tilt:g} rad"
        return ""


def _usable(state: Iterable[Array]) -> bool:
    position, orientation, joints, velocity, forces = (np.asarray(part, dtype=np.float64) for part in state)
    shapes = (position.shape, orientation.shape, joints.shape, velocity.shape, forces.shape)
    if shapes != ((3,), (4,), (4, 3), (18,), (4,)):
        return False
    return _sound(position, orientation, joints, velocity)


@kernel
def _sound(position: Array, orientation: Array, joints: Array, velocity: Array) -> bool:
    """Whether all is finite, and the orientation a unit quaternion."""
    for values in (position, orientation, velocity, joints[0], joints[1], joints[2], joints[3]):
        for value in values:
            if not np.isfinite(value):
                return False
    return bool(abs(np.sum(orientation * orientation) - 1.0) < 0.01)


@kernel
def _saturate(torques: Array, most: Array, dt: float, saturated: Array) -> int:
    """Count for how long each torque has been at its limit (12,); returns which of them for the longest."""
    worst = 0
    for i in range(torques.shape[0]):
        change = dt if abs(torques[i]) >= most[i] else -dt
        saturated[i] = max(saturated[i] + change, 0.0)
        if saturated[i] > saturated[worst]:
            worst = i
    return worst
