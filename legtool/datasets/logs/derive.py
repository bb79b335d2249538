"""Turn aligned rows into recordings: missing signals are derived, and a gap ends a stretch."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from legtool.configs.topics import TopicSettings
from legtool.datasets.logs.align import Rows, join
from legtool.datasets.logs.facts import LogFacts
from legtool.datasets.logs.plausible import check_plausible
from legtool.datasets.logs.recording import Recording
from legtool.datasets.logs.signals import Array, Stamps, trunk_orientation, trunk_position
from legtool_runtime.cache import kernel
from legtool_runtime.robot import LEGS, Robot
from legtool_runtime.rotations import to_base


class Deriver:
    """Turns aligned rows into recordings. The result does not depend on the pieces in which the rows arrive."""

    def __init__(
        self,
        name: str,
        topics: TopicSettings,
        robot: Robot,
        labels: dict[str, str],
        facts: LogFacts,
        joint_offset: Array | None = None,
    ) -> None:
        self.name, self.topics, self.robot, self.labels = (
            name,
            topics,
            robot,
            {**{n.split("/")[0]: label for n, label in labels.items()}, **labels},
        )
        self.window_ns = int(topics.derivative_window_s * 1e9)
        self.facts = facts
        added = topics.joints is not None and topics.joints.zero == "robot" and joint_offset is not None
        self.joint_offset = joint_offset if added else None
        self.kept: Rows | None = None
        self.done = 0

    def push(self, rows: Rows | None, *, final: bool = False) -> Iterator[Recording]:
        """Yield recordings of the rows whose neighbourhood is complete, one for each stretch without a gap."""
        if rows is not None:
            rows = _join_legs(rows)
            if self.joint_offset is not None:
                rows.values["joints"] = rows.values["joints"] + self.joint_offset
            self.kept = rows if self.kept is None else join(self.kept, rows)
        if self.kept is None:
            return
        stamps = self.kept.stamps_ns
        reach = max(self.window_ns, self.facts.gap_ns)  # the next row is a neighbour, however far away in a stretch
        ready = len(stamps) if final else int(np.searchsorted(stamps, stamps[-1] - reach, side="left"))
        if ready <= self.done:
            return
        stretch = np.concatenate([[0], np.cumsum(np.diff(stamps) > self.facts.gap_ns)])
        whole = self._derive(self.kept, stretch)
        fresh = slice(self.done, ready)
        check_plausible(whole.rows(fresh), self.robot, self.labels, self.topics, self.kept[fresh].values.get("joints"))
        sizes = np.bincount(stretch)
        for number in np.unique(stretch[fresh]):
            index = np.flatnonzero(stretch[fresh] == number) + self.done
            if sizes[number] == 1 and self._derives():
                self.facts.alone += 1  # nothing to derive its velocity with
                continue
            yield whole.rows(slice(int(index[0]), int(index[-1]) + 1))
        history = int(np.searchsorted(stamps, stamps[ready - 1] - reach, side="left"))
        history = max(min(history, ready - 1), 0)
        self.kept = self.kept[slice(history, len(stamps))]
        self.done = ready - history

    def _derives(self) -> bool:
        return not {"velocity", "yaw_rate"} <= self.labels.keys()

    def _derive(self, rows: Rows, stretch: NDArray[np.int64]) -> Recording:
        values, topics = rows.values, self.topics
        tracked = values["orientation"]
        orientation = trunk_orientation(topics.orientation, tracked)
        position = trunk_position(topics.position, values["position"], tracked)
        ahead = not topics.events  # at step instants only the past belongs to the state
        if topics.velocity is None or "velocity" not in values:
            velocity = to_base(orientation, slopes(rows.stamps_ns, position, stretch, self.window_ns, ahead))
        elif topics.velocity.frame == "world":
            velocity = to_base(orientation, values["velocity"])
        else:
            velocity = values["velocity"]
        if "yaw_rate" in values:
            yaw_rate = values["yaw_rate"][:, 0]
        else:
            yaw_rate = yaw_rates(rows.stamps_ns, orientation, stretch, self.window_ns, ahead)
        if "feet" not in values:
            feet = self.robot.feet(values["joints"])
        elif topics.feet is not None and topics.feet.frame == "world":
            feet = to_base(orientation, values["feet"].reshape(-1, 4, 3) - position[:, None])
        else:
            feet = values["feet"].reshape(-1, 4, 3)
        return Recording(
            name=self.name,
            stamps_ns=rows.stamps_ns,
            position_world=position,
            orientation=orientation,
            velocity_base=velocity,
            yaw_rate=yaw_rate,
            command=values["command"],
            feet_base=feet,
            contact_force=values.get("contact"),
            swing_pair=values["swing"][:, 0].astype(np.int8) if "swing" in values else None,
        )


def _join_legs(rows: Rows) -> Rows:
    """Signals that come as one stream for each leg, side by side in our leg order."""
    values = {name: value for name, value in rows.values.items() if "/" not in name}
    for name in {name.split("/")[0] for name in rows.values if "/" in name}:
        values[name] = np.concatenate([rows.values[f"{name}/{leg}"] for leg in LEGS], axis=1)
    return Rows(rows.stamps_ns, values)


@kernel
def _bounds(stamps: Stamps, stretch: NDArray[np.int64], i: int, window: int, ahead: bool) -> tuple[int, int]:
    """First and last row about row i within the window and the stretch, the neighbours in any case."""
    first, last = i, i
    while first > 0 and stretch[first - 1] == stretch[i] and (first == i or stamps[i] - stamps[first - 1] <= window):
        first -= 1
    if ahead or first == i:
        end = len(stamps) - 1
        while last < end and stretch[last + 1] == stretch[i] and (last == i or stamps[last + 1] - stamps[i] <= window):
            last += 1
    return first, last


@kernel
def slopes(stamps: Stamps, values: Array, stretch: NDArray[np.int64], window: int, ahead: bool) -> Array:
    """Derivative of ``values`` (n, k) by a least-squares line over ``window`` [ns] to each side, within a stretch.

    Rows without a neighbour get zero. Without ``ahead`` only earlier rows are used, except in a stretch's first row.
    """
    n, width = values.shape
    out = np.zeros((n, width))
    for i in range(n):
        first, last = _bounds(stamps, stretch, i, window, ahead)
        mean_t = 0.0
        for j in range(first, last + 1):
            mean_t += (stamps[j] - stamps[i]) * 1e-9
        mean_t /= last - first + 1
        squares = 0.0
        for j in range(first, last + 1):
            t = (stamps[j] - stamps[i]) * 1e-9 - mean_t
            squares += t * t
            for k in range(width):
                out[i, k] += t * (values[j, k] - values[i, k])
        for k in range(width):
            out[i, k] = out[i, k] / squares if squares > 0.0 else 0.0
    return out


@kernel
def yaw_rates(stamps: Stamps, orientation: Array, stretch: NDArray[np.int64], window: int, ahead: bool) -> Array:
    """(n,) angular velocity about the base's z axis [rad/s], from orientations (n, 4) as in :func:`slopes`."""
    n = len(stamps)
    out = np.zeros(n)
    for i in range(n):
        first, last = _bounds(stamps, stretch, i, window, ahead)
        mean_t = 0.0
        for j in range(first, last + 1):
            mean_t += (stamps[j] - stamps[i]) * 1e-9
        mean_t /= last - first + 1
        squares = 0.0
        w, x, y, z = orientation[i, 0], orientation[i, 1], orientation[i, 2], orientation[i, 3]
        for j in range(first, last + 1):
            q = orientation[j]
            t = (stamps[j] - stamps[i]) * 1e-9 - mean_t
            squares += t * t
            # q_i* q_j: the turn from row i to row j, seen from the base at row i
            real = w * q[0] + x * q[1] + y * q[2] + z * q[3]
            about_z = w * q[3] - x * q[2] + y * q[1] - z * q[0]
            if real < 0.0:
                real, about_z = -real, -about_z
            out[i] += t * 2.0 * np.arctan2(about_z, real)
        out[i] = out[i] / squares if squares > 0.0 else 0.0
    return out
