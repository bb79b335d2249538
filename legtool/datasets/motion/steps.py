"""Check steps one after the other, attach their history, and collect them in a table (motion paper, section III)."""

from __future__ import annotations

from collections import defaultdict, deque
from statistics import median
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from legtool.configs.motion import TransitionSettings
from legtool.datasets.logs.recording import Recording
from legtool_runtime.motion.features import FEATURES
from legtool_runtime.robot import LEGS, TROT_PAIRS
from legtool_runtime.rotations import rotation_of, yaw_of

Array = NDArray[np.float64]

FOOT_DISPLACEMENT = tuple(f"foot_{leg.lower()}_displacement_{axis}" for leg in LEGS for axis in "xyz")
COM_DISPLACEMENT = tuple(f"com_displacement_{axis}" for axis in ("x", "y", "z", "yaw"))
NEXT_VELOCITY = tuple(f"next_velocity_{axis}" for axis in ("x", "y", "yaw"))
POSE = ("position_x", "position_y", "position_z", "yaw")
#: Columns of numbers in the order of the table, after those that name the step.
NUMBERS = ("duration_s", *FEATURES, *FOOT_DISPLACEMENT, *COM_DISPLACEMENT, *NEXT_VELOCITY, *POSE)

#: Status of a row that models may use; all others are kept in the table for inspection.
OK = "ok"
NO_HISTORY = "no_history"
SAME_PAIR = "stumble_same_pair"
_COUNTED = {OK: "steps", NO_HISTORY: "steps_without_history"}

SCHEMA = pa.schema(
    [
        ("recording", pa.string()),
        ("episode", pa.string()),
        ("segment", pa.int32()),
        ("status", pa.string()),
        ("stamp_ns", pa.int64()),
        ("swing_pair", pa.int8()),
        *((name, pa.float64()) for name in NUMBERS),
    ]
)


class State(NamedTuple):
    """The robot at one instant: stamp [ns], position (3,) and rotation (3, 3) in the world, velocity (3,) vx, vy,
    yaw rate in the base frame, feet (4, 3) in the base frame."""

    stamp_ns: int
    position: Array
    rotation: Array
    velocity: Array
    feet: Array


class _History(NamedTuple):
    velocity: Array
    reference: Array
    end_ns: int
    pair: int


class StepWriter:
    """Checks steps one after the other, attaches the history to each, and collects them in a table."""

    def __init__(self, settings: TransitionSettings, *, recording: str, episode: str) -> None:
        self._settings = settings
        self._names = (recording, episode)
        self._segment = 0
        self._segment_used = False
        self._history: _History | None = None
        self._durations: deque[float] = deque(maxlen=31)
        self._last: tuple[int, int] | None = None  # end and pair of the last step, whatever its status
        self._keys: list[tuple[int, str, int, int]] = []
        self._rows: list[Array] = []
        self.counts: defaultdict[str, float] = defaultdict(float)

    @property
    def step_s(self) -> float:
        """Running median duration of a step [s]."""
        return median(self._durations) if self._durations else 0.3

    def add(
        self, start: State, end: State, *, pair: int, reference: Array, standing: tuple[Array, Array] | None = None
    ) -> None:
        """Add one regular swing.

        Args:
            start: state at t.
            end: state at t+1.
            pair: index into TROT_PAIRS of the pair that swung between the two.
            reference: (3,) command that governed the step.
            standing: velocity and reference one step before ``start``, if the robot was standing then.
        """
        if standing is not None:
            self._end_segment()
            history: _History | None = _History(*standing, start.stamp_ns, -1)
        else:
            history = self._history
            if history is not None and history.end_ns != start.stamp_ns:
                history = None
        duration = (end.stamp_ns - start.stamp_ns) * 1e-9
        # δ = R_tᵀ (p(t+1) − p(t)) with each foot's world position from its own instant's rotation (equations 3, 4)
        com = start.rotation.T @ (end.position - start.position)
        change = start.rotation.T @ end.rotation
        feet = end.feet @ change.T + com - start.feet
        again = standing is None and self._last == (start.stamp_ns, pair)
        status = SAME_PAIR if again else self._judge(duration, feet, pair, known=history is not None)
        if status in (OK, NO_HISTORY):
            self._durations.append(duration)
        if status != OK:
            self._end_segment()
        if again:
            # One of the two touchdowns is none: neither half of the step can be believed.
            segment, _, stamp, number = self._keys[-1]
            self._keys[-1] = (segment, SAME_PAIR, stamp, number)
        self._last = (end.stamp_ns, pair)
        yaw, next_yaw = float(yaw_of(start.rotation)), float(yaw_of(end.rotation))
        previous = np.full(6, np.nan) if history is None else np.concatenate([history.velocity, history.reference])
        numbers = np.concatenate(
            [
                [duration], start.velocity, previous[:3], reference, previous[3:], start.feet.ravel(),
                feet.ravel(), com, [(next_yaw - yaw + np.pi) % (2 * np.pi) - np.pi], end.velocity,
                start.position, [yaw],
            ]
        )  # fmt: skip
        self._keys.append((self._segment, status, start.stamp_ns, pair))
        self._rows.append(numbers)
        self._segment_used |= status == OK
        if status in (OK, NO_HISTORY):
            self._history = _History(start.velocity, reference, end.stamp_ns, pair)

    def stumble(self, reason: str) -> None:
        """Count a swing that is not a regular step, and end the segment."""
        self.counts[f"stumble_{reason}"] += 1
        self._end_segment()

    def gap(self) -> None:
        """Count a gap in the log, and end the segment."""
        self.counts["gaps"] += 1
        self._end_segment()

    def table(self) -> tuple[pa.Table, dict[str, float]]:
        """Return a table of all steps so far, and the counts."""
        segment, status, stamp, pair = zip(*self._keys, strict=True) if self._keys else ((), (), (), ())
        numbers = np.array(self._rows) if self._rows else np.empty((0, len(NUMBERS)))
        n = len(self._keys)
        columns = [
            pa.array([self._names[0]] * n, pa.string()),
            pa.array([self._names[1]] * n, pa.string()),
            pa.array(segment, pa.int32()),
            pa.array(status, pa.string()),
            pa.array(stamp, pa.int64()),
            pa.array(pair, pa.int8()),
            *(pa.array(np.ascontiguousarray(column), pa.float64(), from_pandas=True) for column in numbers.T),
        ]
        found = self.counts.copy()
        for name in status:
            found[_COUNTED.get(name, name)] += 1
        found["segments"] += len({number for number, name in zip(segment, status, strict=True) if name == OK})
        counts = {
            name: round(value, 6) if name.endswith("_s") else int(value)
            for name, value in sorted(found.items())
            if value or name in self.counts
        }
        return pa.Table.from_arrays(columns, schema=SCHEMA), {"steps": counts.pop("steps", 0), **counts}

    def _judge(self, duration: float, feet: Array, pair: int, *, known: bool) -> str:
        settings = self._settings
        median_s = self.step_s
        settled = len(self._durations) >= 5
        ratio = max(duration / median_s, median_s / duration) if settled else 1.0
        if duration < settings.min_step_s:
            return "stumble_short_step"
        if duration > settings.max_step_s or ratio > settings.step_time_ratio:
            return "stumble_step_time"
        # along the ground: a foot that settles into it, or was logged just before it landed, does not slip
        if np.linalg.norm(feet[list(TROT_PAIRS[1 - pair]), :2], axis=1).max() > settings.max_slip_m:
            return "stumble_slip"
        return OK if known else NO_HISTORY

    def _end_segment(self) -> None:
        self._history = None
        self._segment += self._segment_used
        self._segment_used = False


def states(rows: Recording, index: NDArray[np.intp] | list[int]) -> list[State]:
    """Return the states at some rows of a recording."""
    index = np.asarray(index, dtype=np.intp)
    rotation = rotation_of(rows.orientation[index])
    velocity = np.column_stack([rows.velocity_base[index, :2], rows.yaw_rate[index]])
    return [
        State(int(rows.stamps_ns[i]), rows.position_world[i], rotation[k], velocity[k], rows.feet_base[i])
        for k, i in enumerate(index)
    ]
