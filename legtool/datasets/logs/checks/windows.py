"""A log in windows of a fifth of a second: means of its signals beside what the pose says, small enough to be kept."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from legtool.datasets.logs.recording import Recording, concatenate
from legtool_runtime.rotations import rotation_of, yaw_of

Array = NDArray[np.float64]

#: Length of a window [s].
WINDOW_S = 0.2


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of a log (n), in time order.

    Attributes:
        start_s: time of the first row since the first row of the log [s].
        seconds: from its first row to its last [s].
        moved_base: (n, 2) displacement of the trunk by time, in its own frame at mid-window [m/s].
        moved_world: (n, 2) the same, world frame [m/s].
        turned: change of yaw by time [rad/s].
        velocity: (n, 2) mean of the velocity as given, base frame [m/s].
        velocity_world: (n, 2) mean of the velocity as given, turned into the world frame [m/s].
        yaw_rate: mean of the yaw rate as given [rad/s].
        command: (n, 3) mean of the command.
        feet: (n, 4, 3) mean of the feet, base frame [m].
        follows: whether the window before it ends where it begins.
    """

    start_s: Array
    seconds: Array
    moved_base: Array
    moved_world: Array
    turned: Array
    velocity: Array
    velocity_world: Array
    yaw_rate: Array
    command: Array
    feet: Array
    follows: Array

    def __len__(self) -> int:
        return len(self.start_s)

    def where(self, chosen: NDArray[np.bool_]) -> Windows:
        """Some of the windows."""
        return Windows(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})


class WindowCollector:
    """Collects windows from the recordings of one log, however they are divided."""

    def __init__(self, *, gap_s: float) -> None:
        """Take ``gap_s``: rows further apart than this are never in one window [s]."""
        self._gap_ns = round(gap_s * 1e9)
        self._rest: Recording | None = None
        self._first_ns: int | None = None
        self._parts: list[dict[str, NDArray[np.float32]]] = []
        self._end_ns = 0

    def add(self, recording: Recording) -> None:
        """Take the next rows of the log."""
        if not len(recording):
            return
        if self._rest is not None and recording.stamps_ns[0] <= self._rest.stamps_ns[-1]:
            self._rest = self._first_ns = None  # another session
        rows = recording if self._rest is None else concatenate([self._rest, recording])
        if self._first_ns is None:
            self._first_ns = int(rows.stamps_ns[0])
        self._rest = self._collect(rows, final=False)

    def windows(self) -> Windows:
        """All windows so far."""
        if self._rest is not None and len(self._rest) > 1:
            self._rest = self._collect(self._rest, final=True)
        names = [field.name for field in fields(Windows)]
        if not self._parts:
            shapes: dict[str, tuple[int, ...]] = {
                "start_s": (0,),
                "seconds": (0,),
                "turned": (0,),
                "yaw_rate": (0,),
                "follows": (0,),
            }
            shapes |= {"command": (0, 3), "feet": (0, 4, 3)}
            return Windows(**{name: np.zeros(shapes.get(name, (0, 2))) for name in names})
        return Windows(
            **{name: np.concatenate([part[name] for part in self._parts]).astype(np.float64) for name in names}
        )

    def _collect(self, rows: Recording, *, final: bool) -> Recording:
        """Make windows of the rows and return those that are left over."""
        stamps = rows.stamps_ns
        gaps = np.concatenate([[False], np.diff(stamps) > self._gap_ns])
        # A window begins at the first row that is a window's length after the last one's beginning, or after a gap.
        starts = [0]
        length = round(WINDOW_S * 1e9)
        breaks = np.flatnonzero(gaps)
        while True:
            at = starts[-1]
            end = int(np.searchsorted(stamps, stamps[at] + length))
            ahead = breaks[np.searchsorted(breaks, at, "right") :]
            end = max(end, at + 1)
            if len(ahead) and ahead[0] <= end:
                end = int(ahead[0])
            if end >= len(stamps):
                break
            starts.append(end)
        begin = np.array(starts[:-1], dtype=np.intp)
        stop = np.array(starts[1:], dtype=np.intp)
        if final:
            begin, stop = np.append(begin, starts[-1]), np.append(stop, len(stamps) - 1)
        stop = np.where(gaps[stop], stop - 1, stop)  # the row where the next one begins, or the last before a gap
        whole = stop > begin
        if whole.any():
            self._parts.append(self._means(rows, begin[whole], stop[whole]))
        return rows.rows(slice(starts[-1], None))

    def _means(
        self, rows: Recording, begin: NDArray[np.intp], stop: NDArray[np.intp]
    ) -> dict[str, NDArray[np.float32]]:
        stamps = rows.stamps_ns
        seconds = (stamps[stop] - stamps[begin]) * 1e-9
        rotation = rotation_of(rows.orientation)
        moved = (rows.position_world[stop] - rows.position_world[begin]) / seconds[:, None]
        middle = (begin + stop) // 2
        yaw = np.asarray(yaw_of(rotation))
        turn = (yaw[stop] - yaw[begin] + np.pi) % (2 * np.pi) - np.pi

        def mean(values: Array) -> Array:
            """Means over each window, in which the rows at its ends count by half."""
            flat = np.asarray(values, dtype=np.float64).reshape(len(stamps), -1)
            half = 0.5 * (flat[1:] + flat[:-1]) * (np.diff(stamps) * 1e-9)[:, None]
            total = np.concatenate([np.zeros((1, flat.shape[1])), np.cumsum(half, axis=0)])
            return ((total[stop] - total[begin]) / seconds[:, None]).reshape(len(begin), *np.shape(values)[1:])

        assert self._first_ns is not None
        follows = np.concatenate([[float(stamps[begin[0]]) == self._end_ns], begin[1:] == stop[:-1]])
        self._end_ns = int(stamps[stop[-1]])
        out = {
            "start_s": (stamps[begin] - self._first_ns) * 1e-9,
            "seconds": seconds,
            "moved_base": np.einsum("nji,nj->ni", rotation[middle], moved)[:, :2],
            "moved_world": moved[:, :2],
            "turned": turn / seconds,
            "velocity": mean(rows.velocity_base[:, :2]),
            "velocity_world": mean(np.einsum("nij,nj->ni", rotation, rows.velocity_base)[:, :2]),
            "yaw_rate": mean(rows.yaw_rate),
            "command": mean(rows.command),
            "feet": mean(rows.feet_base),
            "follows": follows.astype(np.float64),
        }
        return {name: np.asarray(value, dtype=np.float32) for name, value in out.items()}
