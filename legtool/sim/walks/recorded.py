"""A recorded robot: a log in the place of a simulated one. Nothing that it is told is carried out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool.configs.motion import TransitionSettings
from legtool.datasets.logs.depth import DepthFrame, DepthLog
from legtool.datasets.logs.log import LogReader
from legtool.datasets.logs.recording import Recording
from legtool.datasets.motion.contacts import Scale, calibrate, load_signal
from legtool.sim.robots.state import RobotState
from legtool.sim.walks.environment import Answer, DepthImage, Measured, Observation
from legtool_runtime.robot import Robot
from legtool_runtime.rotations import to_world

Array = NDArray[np.float64]

#: The outcome of a log that was played to its end.
END = "end"
#: Of foot loads that are brought into one unit: what lifts a foot off, and what it lands with.
OFF, ON = 1.0, 2.0
#: An image is handed out with the first row after it, if that comes within this [ns].
_LATE_NS = 200_000_000


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Rows of a log: the recording, and what planners ask for at each of them."""

    rows: Recording
    velocity: Array
    velocity_world: Array
    joints: Array
    loads: Array


class RecordedRobot:
    """A robot in a log; an :class:`.Environment`.

    Attributes:
        parts: what was played of the log so far, as recordings.
        row: number of the row that was observed last, in the last of ``parts``.
        missed: images that were left out because no row came soon after them.
    """

    def __init__(
        self, reader: LogReader, robot: Robot, *, depth: DepthLog | None = None, thresholds: bool = True
    ) -> None:
        """Open a log.

        Args:
            reader: of its signals.
            robot: its geometry.
            depth: its depth images; none: it is blind.
            thresholds: whether loads of feet are brought into one unit, in which ``OFF`` lifts a foot off and ``ON``
                is what it lands with; logs without forces take the motion of their feet.

        Raises:
            LogError: the log is damaged, or holds no rows.
        """
        self.parts: list[Recording] = []
        self.row, self.missed = -1, 0
        self._robot, self._depth, self._scaled = robot, depth, thresholds
        self._scale: Scale | None = None
        self._recordings = reader.recordings()
        self._now: _Stretch | None = self._next()
        assert self._now is not None  # a log without rows is refused by its reader
        stamps = self._now.rows.stamps_ns
        self._start_ns = int(stamps[0])
        self._period_ns = int(np.median(np.diff(stamps))) if len(stamps) > 1 else 1
        self._frames: Iterator[DepthFrame] = depth.frames() if depth is not None else iter(())
        self._frame: DepthFrame | None = next(self._frames, None)
        self._state = RobotState()
        self._commanded = np.zeros(3)
        self._finished = False

    @property
    def time_s(self) -> float:
        """Since the first row [s], counted as who recorded it at a steady rate counted: rows times their period."""
        elapsed = self.stamp_ns - self._start_ns
        count, rest = divmod(elapsed, self._period_ns)
        return elapsed / 1e9 if rest else count * (self._period_ns / 1e9)

    @property
    def stamp_ns(self) -> int:
        """Of the row that is observed [ns]."""
        return int(self.parts[-1].stamps_ns[max(self.row, 0)])

    def begin(self) -> None:
        """The first row is there already."""

    def observe(self) -> Observation:
        """The next row of the log, with the image that came since the last one."""
        self.row += 1
        assert self._now is not None
        now, row, state = self._now, self.row, self._state
        rows = now.rows
        state.position_world[:] = rows.position_world[row]
        state.orientation[:] = rows.orientation[row]
        state.velocity_world[:] = now.velocity_world[row]
        state.angular_velocity_base[2] = rows.yaw_rate[row]
        state.joint_positions[:] = now.joints[row]
        state.foot_forces[:] = now.loads[row]
        measured = Measured(now.velocity[row], rows.feet_base[row], self._commanded)
        self._commanded = rows.command[row]
        return Observation(self.time_s, state, image=self._image(int(rows.stamps_ns[row])), measured=measured)

    def apply(self, answer: Answer) -> None:
        """Nothing is commanded: the log goes on as it went."""

    def outcome(self) -> str:
        """``end`` after the last row; empty before."""
        assert self._now is not None
        if self.row + 1 < len(self._now.rows):
            return ""
        following = self._next()
        if following is None:
            return END
        self._now, self.row = following, -1
        return ""

    def _next(self) -> _Stretch | None:
        rows = next(self._recordings, None)
        if rows is None:
            return None
        if self._scale is None:
            self._scale = calibrate(rows, TransitionSettings())
        self.parts.append(rows)
        velocity = np.column_stack([rows.velocity_base[:, :2], rows.yaw_rate])
        joints, _ = self._robot.joints(rows.feet_base)
        loads = rows.contact_force if rows.contact_force is not None else np.zeros((len(rows), 4))
        if self._scaled and not rows.events:
            scale = self._scale
            loads = OFF + (ON - OFF) * (load_signal(rows, scale) - scale.off) / (scale.on - scale.off)
        world = to_world(rows.orientation, rows.velocity_base)
        return _Stretch(rows, velocity, world, joints.reshape(-1, 4, 3), loads)

    def _image(self, stamp_ns: int) -> DepthImage | None:
        """The latest image up to a row, if it is a fresh one."""
        found: DepthFrame | None = None
        while self._frame is not None and self._frame.stamp_ns <= stamp_ns:
            self.missed += found is not None
            found, self._frame = self._frame, next(self._frames, None)
        if found is None or self._depth is None:
            return None
        if stamp_ns - found.stamp_ns > _LATE_NS:
            self.missed += 1
            return None
        return DepthImage(found.depth, self._depth.camera, self._depth.transform_camera_to_base)
