"""Where the body shall be over a horizon: as the feet of a contact plan imply, or a pose planner asks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.errors import TrackingError
from legtool_runtime.robot import Robot
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.contact_plan import ContactPlan, PlanTable, foot_at, stance_at
from legtool_runtime.tracking.ground import ground_of
from legtool_runtime.tracking.reach import Legs, fit_poses, level_pose

Array = NDArray[np.float64]

#: Between control points [s].
STEP_S = 0.05
#: Share of the slope of the feet's plane that the body tilts by.
_TILT = 0.8
#: Smoothing of what feet imply: two swinging legs and one (crawl) [s].
_SIGMA_S, _CRAWL_SIGMA_S = 0.25, 0.15
#: Weight of the one swinging leg of a crawl, from so long before its lift-off.
_SWING_WEIGHT, _BEFORE_S = 0.2, 0.05
#: How long before a limit is reached the pose begins to answer it [s].
_ANSWER_S = 0.1


class BodyPoint(NamedTuple):
    """The reference at an instant, world frame: of the centre of mass [m, m/s, m/s²], and of the body's rotation.

    ``position``, ``velocity``, ``acceleration`` (3,); ``attitude`` (3,) roll, pitch, yaw [rad] (rotation by yaw, pitch
    and roll about the moved axes); ``rotation`` (3, 3) body to world; ``angular_velocity`` (3,) [rad/s];
    ``angular_acceleration`` (3,) [rad/s²].
    """

    position: Array
    velocity: Array
    acceleration: Array
    attitude: Array
    rotation: Array
    angular_velocity: Array
    angular_acceleration: Array


@dataclass(frozen=True, eq=False)
class BodyReference:
    """A uniform cubic B-spline: position, rates and accelerations are continuous; it rests before and after.

    Attributes:
        start_s: time of the first control point.
        step_s: between two of them.
        control: (n, 6) x, y, z of the centre of mass [m], roll, pitch, yaw [rad], world frame.
    """

    start_s: float
    step_s: float
    control: Array

    @property
    def end_s(self) -> float:
        """Time of the last control point."""
        return self.start_s + (len(self.control) - 1) * self.step_s

    def at(self, time_s: float) -> BodyPoint:
        """The reference at an instant."""
        spline, turn = np.empty((3, 6)), np.empty((3, 3))
        spline_at(self.start_s, self.step_s, self.control, time_s, spline)
        rates = np.empty((2, 3))
        turning(spline, turn, rates)
        return BodyPoint(spline[0, :3], spline[1, :3], spline[2, :3], spline[0, 3:], turn, rates[0], rates[1])

    def base_at(self, time_s: float, com_offset: ArrayLike) -> Array:
        """(3,) where the trunk's origin shall be, for a centre of mass at ``com_offset`` (3,) in the base frame [m]."""
        point = self.at(time_s)
        return point.position - point.rotation @ np.asarray(com_offset, dtype=np.float64)


@kernel
def spline_at(start: float, step: float, control: Array, time: float, out: Array) -> None:
    """Write the spline's value, velocity and acceleration (3, k) at a time; held at its ends."""
    last = control.shape[0] - 1
    place = min(max((time - start) / step, -2.0), last + 2.0)
    k = int(np.floor(place))
    t = place - k
    u = 1.0 - t
    weights = np.empty((3, 4))
    weights[0, 0], weights[0, 3] = u * u * u / 6.0, t * t * t / 6.0
    weights[0, 1] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
    weights[0, 2] = 1.0 - weights[0, 0] - weights[0, 1] - weights[0, 3]
    weights[1, 0], weights[1, 1] = -0.5 * u * u / step, (1.5 * t * t - 2.0 * t) / step
    weights[1, 2], weights[1, 3] = (0.5 + t - 1.5 * t * t) / step, 0.5 * t * t / step
    square = step * step
    weights[2, 0], weights[2, 1] = u / square, (3.0 * t - 2.0) / square
    weights[2, 2], weights[2, 3] = (1.0 - 3.0 * t) / square, t / square
    out[:] = 0.0
    for i in range(4):
        row = min(max(k - 1 + i, 0), last)
        for d in range(3):
            for j in range(control.shape[1]):
                out[d, j] += weights[d, i] * control[row, j]


@kernel
def turning(spline: Array, rotation: Array, rates: Array) -> None:
    """Write rotation (3, 3), angular velocity and acceleration (2, 3), world frame, of a spline's roll, pitch, yaw."""
    cr, sr = np.cos(spline[0, 3]), np.sin(spline[0, 3])
    cp, sp = np.cos(spline[0, 4]), np.sin(spline[0, 4])
    cy, sy = np.cos(spline[0, 5]), np.sin(spline[0, 5])
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = -sp, cp * sr, cp * cr
    roll, pitch, yaw = spline[1, 3], spline[1, 4], spline[1, 5]
    # Axes of roll and pitch in the world, and how they turn.
    ax, ay, az = cy * cp, sy * cp, -sp
    rates[0, 0] = roll * ax - pitch * sy
    rates[0, 1] = roll * ay + pitch * cy
    rates[0, 2] = roll * az + yaw
    dax, day, daz = -yaw * ay - pitch * cy * sp, yaw * ax - pitch * sy * sp, -pitch * cp
    rates[1, 0] = spline[2, 3] * ax - spline[2, 4] * sy + roll * dax - pitch * yaw * cy
    rates[1, 1] = spline[2, 3] * ay + spline[2, 4] * cy + roll * day - pitch * yaw * sy
    rates[1, 2] = spline[2, 3] * az + spline[2, 5] + roll * daz


@kernel
def _tracks(
    table: PlanTable, first: float, step: float, before: float, radius: float, feet: Array, weights: Array
) -> None:
    """Write feet (n, 4, 3) over time and their weights (n, 4) in a crawl."""
    for k in range(feet.shape[0]):
        time = first + k * step
        swinging, which = 0, 0
        for leg in range(4):
            foot_at(table, leg, time, feet[k, leg])
            feet[k, leg, 2] += radius
            weights[k, leg] = 1.0
            if stance_at(table, leg, time) < 0 or stance_at(table, leg, time + before) < 0:
                swinging, which = swinging + 1, leg
        if swinging == 1:
            weights[k, which] = _SWING_WEIGHT


@kernel
def _level_poses(feet: Array, weights: Array, height: float, out: Array) -> None:
    for k in range(out.shape[0]):
        level_pose(feet[k], weights[k], height, _TILT, out[k])
        if k > 0:
            turns = np.round((out[k, 5] - out[k - 1, 5]) / (2.0 * np.pi))
            out[k, 5] -= 2.0 * np.pi * turns


@kernel
def _smooth(values: Array, sigma: float, out: Array) -> None:
    """Gaussian smoothing over the rows of ``values`` (n, k); ``sigma`` in rows."""
    n, half = values.shape[0], int(np.ceil(3.0 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / max(sigma, 1e-9)) ** 2)
    kernel /= kernel.sum()
    out[:] = 0.0
    for k in range(n):
        for i in range(-half, half + 1):
            w, row = kernel[i + half], min(max(k + i, 0), n - 1)
            for j in range(values.shape[1]):
                out[k, j] += w * values[row, j]


@kernel
def _stands(table: PlanTable, first: float, step: float, standing: NDArray[np.bool_]) -> None:
    """Whether each leg stands (n, 4) at some instant of each step around a time."""
    for k in range(standing.shape[0]):
        time = first + k * step
        for leg in range(4):
            standing[k, leg] = (
                stance_at(table, leg, time) >= 0
                or stance_at(table, leg, time - 0.5 * step) >= 0
                or stance_at(table, leg, time + 0.5 * step) >= 0
            )


class ReferenceMaker:
    """Makes body references for one robot."""

    def __init__(self, robot: Robot, *, com_offset: ArrayLike = (0.0, 0.0, 0.0), height_m: float | None = None) -> None:
        """Take the robot, its centre of mass (3,) in the base frame [m], and its height.

        Args:
            robot: geometry.
            com_offset: centre of mass in the base frame when standing [m].
            height_m: of the trunk's origin over the ground when standing; None: the robot's own.

        Raises:
            TrackingError: an offset that is not finite, or a height out of the legs' reach.
        """
        self.robot, self.legs = robot, Legs.of(robot, com_offset)
        self.com_offset = np.array(com_offset, dtype=np.float64)
        height = robot.standing_height if height_m is None else float(height_m)
        if not 0.3 * self.legs.size < height < 1.5 * self.legs.size:
            raise TrackingError(
                f"body height {height} m, expected {0.3 * self.legs.size:.2f} to {1.5 * self.legs.size:.2f}"
            )
        #: What the last reference was moved by from its first control point on: the next one begins its search there.
        self._moved: tuple[float, Array] | None = None
        #: Of the centre of mass over the feet's centres [m].
        self.height = height - robot.foot_radius + float(self.com_offset[2])

    @property
    def _time_scale(self) -> float:
        """Slower bodies are taller: times of the notes are for a centre of mass at 0.5 m."""
        return math.sqrt(self.height / 0.5)

    def from_contacts(
        self,
        plan: ContactPlan,
        *,
        start_s: float,
        horizon_s: float = 2.0,
        poses: Callable[[Array], Array] | None = None,
        elevation: HeightMap | None = None,
    ) -> BodyReference:
        """The reference that the feet of a plan imply, held within what the standing legs reach.

        Every foot goes evenly to its next place during its swing; the centre of mass is over the mean of the feet
        (a crawl: over that with a lighter swinging leg), and tilts by 0.8 of their plane's slope; smoothed.

        Args:
            plan: where feet stand, also some time before ``start_s``.
            start_s: begin of the horizon.
            horizon_s: its length.
            poses: (n, 3) height of the trunk's origin, world frame [m], roll, pitch [rad] by times (n,) after
                ``start_s`` [s], in place of those that the feet imply.
            elevation: the ground, to keep thighs and shanks off it; None: no part of the search.
        """
        nominal, feet, first = self._nominal(plan, start_s, horizon_s)
        if poses is not None:
            self._pose(nominal, poses(np.float64(first - start_s) + STEP_S * np.arange(len(nominal), dtype=np.float64)))
        return self._held(nominal, feet, plan, first, elevation)

    def _pose(self, nominal: Array, poses: Array) -> None:
        """Set height, roll and pitch of the centre of mass to those of the trunk's origin."""
        nominal[:, 3:5] = poses[:, 1:]
        x, y, z = self.com_offset
        roll, pitch = poses[:, 1], poses[:, 2]
        nominal[:, 2] = poses[:, 0] - np.sin(pitch) * x + np.cos(pitch) * (np.sin(roll) * y + np.cos(roll) * z)

    def _span(self, start_s: float, horizon_s: float) -> tuple[float, int]:
        """First control point and their number: a little more than the horizon on both sides."""
        if not (math.isfinite(start_s) and 0.0 < horizon_s <= 20.0):
            raise TrackingError(f"body reference: from {start_s} s for {horizon_s} s; expected up to 20 s")
        # On a raster of its own, so that one made a moment later has the same control points.
        first = STEP_S * math.floor((start_s - 0.3) / STEP_S)
        return first, math.ceil((start_s + horizon_s + 0.3 - first) / STEP_S) + 1

    def _nominal(self, plan: ContactPlan, start_s: float, horizon_s: float) -> tuple[Array, Array, float]:
        first, count = self._span(start_s, horizon_s)
        pad = math.ceil(3 * _SIGMA_S * self._time_scale / STEP_S)
        feet, weights = np.empty((count + 2 * pad, 4, 3)), np.empty((count + 2 * pad, 4))
        _tracks(plan.table, first - pad * STEP_S, STEP_S, _BEFORE_S, self.robot.foot_radius, feet, weights)
        crawls = bool((weights.min(axis=1) < 1.0).any())
        raw, nominal = np.empty((len(feet), 6)), np.empty((len(feet), 6))
        _level_poses(feet, weights, self.height, raw)
        _smooth(raw, (_CRAWL_SIGMA_S if crawls else _SIGMA_S) * self._time_scale / STEP_S, nominal)
        return nominal[pad : pad + count].copy(), feet[pad : pad + count].copy(), first

    def _held(
        self, nominal: Array, feet: Array, plan: ContactPlan, first: float, elevation: HeightMap | None
    ) -> BodyReference:
        standing = np.zeros((len(nominal), 4), np.bool_)
        _stands(plan.table, first, STEP_S, standing)
        offsets = self._begin(first, len(nominal))
        smoothness = (_ANSWER_S * self._time_scale / STEP_S) ** 4
        fit_poses(self.legs, nominal, feet, standing, ground_of(elevation), smoothness, offsets)
        nominal[:, :5] += offsets
        self._moved = first, offsets
        return BodyReference(first, STEP_S, nominal)

    def _begin(self, first: float, count: int) -> Array:
        """(n, 5) offsets to begin a search with: those of the last reference, a little later."""
        if self._moved is None:
            return np.zeros((count, 5))
        then, offsets = self._moved
        rows = np.arange(count) + round((first - then) / STEP_S)
        return np.where(
            ((rows >= 0) & (rows < len(offsets)))[:, None], offsets[np.clip(rows, 0, len(offsets) - 1)], 0.0
        )


@dataclass(frozen=True, eq=False)
class PoseFilter:
    """A critically damped second-order filter of height, roll and pitch, with limited rates.

    Attributes:
        value: (3,) height [m], roll, pitch [rad].
        rate: (3,) of them.
        frequency: [rad/s].
        height_rate: largest [m/s].
        tilt_rate: largest [rad/s].
    """

    value: Array
    rate: Array
    frequency: float = 8.0
    height_rate: float = 0.4
    tilt_rate: float = 0.9

    def ahead(self, target: ArrayLike, times: ArrayLike) -> Array:
        """(n, 3, 3) value, velocity and acceleration at times (n,) from now on [s], in order, for a constant target.

        Times before 0 give the present value.

        Raises:
            TrackingError: a target or times that are not finite.
        """
        goal, at = np.asarray(target, dtype=np.float64), np.asarray(times, dtype=np.float64)
        if goal.shape != (3,) or not (np.isfinite(goal).all() and np.isfinite(at).all()):
            raise TrackingError(f"pose filter: target {goal.tolist()}, expected finite height, roll and pitch")
        out = np.empty((len(at), 3, 3))
        limits = np.array([self.height_rate, self.tilt_rate, self.tilt_rate])
        state = np.array([self.value, self.rate], dtype=np.float64)
        _filter(state, goal, self.frequency, limits, at, out)
        return out

    def after(self, target: ArrayLike, dt: float) -> PoseFilter:
        """The filter ``dt`` later [s]."""
        value, rate, _ = self.ahead(target, [dt])[0]
        return replace(self, value=value, rate=rate)


@kernel
def _filter(state: Array, goal: Array, frequency: float, limits: Array, times: Array, out: Array) -> None:
    now, acceleration = 0.0, np.zeros(3)
    for i in range(3):
        acceleration[i] = frequency * (frequency * (goal[i] - state[0, i]) - 2.0 * state[1, i])
    for k in range(times.shape[0]):
        while now < times[k] - 1e-12:
            step = min(0.002, times[k] - now)
            for i in range(3):
                wanted = frequency * (frequency * (goal[i] - state[0, i]) - 2.0 * state[1, i])
                rate = min(max(state[1, i] + step * wanted, -limits[i]), limits[i])
                acceleration[i] = (rate - state[1, i]) / step
                state[0, i] += step * 0.5 * (rate + state[1, i])
                state[1, i] = rate
            now += step
        for i in range(3):
            out[k, 0, i], out[k, 1, i], out[k, 2, i] = state[0, i], state[1, i], acceleration[i]
