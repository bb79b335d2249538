"""The path of a foot from lift-off to its foothold and on down to the ground, with velocity and acceleration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.errors import TrackingError
from legtool_runtime.foothold.swing import Swing
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.ground import Ground, ground_of, lowest_centre
from legtool_runtime.tracking.settings import Profile

Array = NDArray[np.float64]

#: Of the planned profile: share of the swing until the apex; begin and end of the way across.
_APEX, _ACROSS = 0.45, (0.12, 0.88)
#: Begin and end of the swing in which the foot may be near the ground, as shares.
_NEAR = 0.20
_RAISE_M, _HIGHEST_M = 0.02, 0.10
#: At how many phases a swing is held against the ground, and how near to its ends the map is not believed [m].
_LOOKS, _STANDS_M = 41, 0.005
#: The search for late ground: how long it takes to speed up [s], and over how much of its depth it slows down.
_RAMP_S, _BRAKE = 0.05, 0.25


class FootMotion(NamedTuple):
    """Of the foot's centre: ``position`` [m], ``velocity`` [m/s], ``acceleration`` [m/s²], (3,) each."""

    position: Array
    velocity: Array
    acceleration: Array


class _Course(NamedTuple):
    """A timed swing for compiled code: ends (3,) before it was bent, ``bends`` (b, 4) phases and ways."""

    lift: Array
    end: Array
    bends: Array
    duration: float
    height: float
    speed: float
    depth: float
    planned: bool


@dataclass(frozen=True, eq=False)
class TimedSwing(Swing):
    """A swing with a duration: velocity and acceleration, and the way on down when the ground is late.

    Attributes:
        duration_s: from lift-off to the planned touchdown.
        profile: of the path.
        search_speed: at which the foot comes down and goes on down [m/s].
        search_depth_m: how far below the foothold it goes at most.
    """

    duration_s: float = 0.4
    profile: Profile = "planned"
    search_speed: float = 0.15
    search_depth_m: float = 0.06

    def __post_init__(self) -> None:
        numbers = np.array([*self.lift_off, *self.foothold, self.height_m], dtype=np.float64)
        if numbers.shape != (7,) or not np.isfinite(numbers).all() or self.profile not in ("planned", "judged"):
            raise TrackingError(
                f"swing: from {np.asarray(self.lift_off).tolist()} to {np.asarray(self.foothold).tolist()}, "
                f"{self.height_m} m high, profile {self.profile!r}; expected finite numbers, planned or judged"
            )
        limits = (self.duration_s, 0.05, 10.0), (self.search_speed, 0.0, 2.0), (self.search_depth_m, 0.0, 1.0)
        if not all(low <= value <= high for value, low, high in limits):
            raise TrackingError(
                f"swing: {self.duration_s} s, search at {self.search_speed} m/s to {self.search_depth_m} m; expected "
                "0.05 to 10 s, 0 to 2 m/s, 0 to 1 m"
            )

    def position(self, phase: float) -> Array:
        """(3,) the foot's centre at ``phase`` 0 (lift-off) to 1 (touchdown), beyond it while it searches [m]."""
        return self.at(phase).position

    def at(self, phase: float) -> FootMotion:
        """The foot's motion at ``phase``; beyond 1 it goes on down, at most to the search's depth."""
        out = np.empty((3, 3))
        _motion(self._course, phase, out)
        return FootMotion(out[0], out[1], out[2])

    def along(self, phases: Array) -> Array:
        """(n, 3) the foot's centre at phases (n,) [m]."""
        out = np.empty((len(phases), 3))
        _positions(self._course, phases, out)
        return out

    @cached_property
    def _course(self) -> _Course:
        first = np.array(self.foothold, dtype=np.float64)
        bends = np.zeros((len(self.bends), 4))
        for row, (begin, way) in zip(bends, self.bends, strict=True):
            row[0], row[1:] = begin, way
            first -= way
        return _Course(
            np.array(self.lift_off, np.float64), first, bends, float(self.duration_s), float(self.height_m),
            float(self.search_speed), float(self.search_depth_m), self.profile == "planned",
        )  # fmt: skip

    def clear_of(
        self, elevation: HeightMap | None, *, radius: float, margin_m: float = 0.015
    ) -> tuple[TimedSwing, bool]:
        """The swing, its apex raised in steps of 2 cm by up to 10 cm until the foot clears the ground.

        Args:
            elevation: the ground; unknown cells count as clear.
            radius: of the foot [m].
            margin_m: above the ground, but for the swing's begin and end.

        Returns:
            the swing, and whether it clears the ground; the highest one where none does.
        """
        ground, end = ground_of(elevation), np.array(self.foothold, dtype=np.float64)
        swing, raised = self, 0.0
        while True:
            if _clears(swing._course, end, ground, radius, margin_m):
                return swing, True
            raised += _RAISE_M
            if raised > _HIGHEST_M + 1e-9:
                return swing, False
            swing = replace(self, height_m=self.height_m + raised)

    def adjust(self, foothold: Sequence[float] | Array, *, phase: float) -> TimedSwing:
        """The swing to another foothold from ``phase`` on, see :meth:`Swing.adjust`."""
        bent = super().adjust(foothold, phase=phase)
        assert isinstance(bent, TimedSwing)
        return bent


@kernel
def _quintic(u: float) -> tuple[float, float, float]:
    """Minimum jerk from 0 to 1 and its derivatives; at rest before and after."""
    if u <= 0.0:
        return 0.0, 0.0, 0.0
    if u >= 1.0:
        return 1.0, 0.0, 0.0
    return (
        u * u * u * (10.0 - 15.0 * u + 6.0 * u * u),
        30.0 * u * u * (1.0 - u) * (1.0 - u),
        60.0 * u * (1.0 - u) * (1.0 - 2.0 * u),
    )


@kernel
def _searched(time: float, speed: float, depth: float, at_speed: bool) -> tuple[float, float, float]:
    """How far below the foothold after a time, its velocity and acceleration: speeds up, goes on, slows down."""
    if speed <= 0.0 or depth <= 0.0:
        return 0.0, 0.0, 0.0
    ramp = 0.0 if at_speed else min(_RAMP_S, depth / speed)
    ramp_way = 0.5 * speed * ramp
    brake_way = _BRAKE * depth
    brake = 2.0 * brake_way / speed
    steady = max(depth - ramp_way - brake_way, 0.0) / speed
    if time < ramp:
        return 0.5 * speed / ramp * time * time, speed * time / ramp, speed / ramp
    time -= ramp
    if time < steady:
        return ramp_way + speed * time, speed, 0.0
    time -= steady
    way = ramp_way + speed * steady
    if time < brake:
        return way + speed * time - 0.5 * speed / brake * time * time, speed * (1.0 - time / brake), -speed / brake
    return way + brake_way, 0.0, 0.0


@kernel
def _motion(path: _Course, phase: float, out: Array) -> None:
    """Write position, velocity and acceleration (3, 3)."""
    lift, end, bends = path.lift, path.end, path.bends
    duration, height, speed = path.duration, path.height, path.speed
    out[1:] = 0.0
    s = min(max(phase, 0.0), 1.0)
    apex = max(lift[2], end[2]) + height
    if path.planned:
        span = _ACROSS[1] - _ACROSS[0]
        w, dw, ddw = _quintic((s - _ACROSS[0]) / span)
        dw, ddw = dw / span, ddw / (span * span)
        if s < _APEX:
            r, dr, ddr = _quintic(s / _APEX)
            z, dz, ddz = (
                lift[2] + (apex - lift[2]) * r,
                (apex - lift[2]) * dr / _APEX,
                (apex - lift[2]) * ddr / _APEX**2,
            )
        else:
            # A quintic from rest at the apex to the foothold at the search's speed, without acceleration at both.
            share = 1.0 - _APEX
            u = (s - _APEX) / share
            r, dr, ddr = _quintic(u)
            final = -speed * duration * share
            e = u * u * u * (-4.0 + 7.0 * u - 3.0 * u * u)
            de = u * u * (-12.0 + 28.0 * u - 15.0 * u * u)
            dde = u * (-24.0 + 84.0 * u - 60.0 * u * u)
            drop = end[2] - apex
            z = apex + drop * r + final * e
            dz, ddz = (drop * dr + final * de) / share, (drop * ddr + final * dde) / (share * share)
    else:
        turn = 2.0 * np.pi
        w, dw, ddw = s - np.sin(turn * s) / turn, 1.0 - np.cos(turn * s), turn * np.sin(turn * s)
        first = s < 0.5
        u = 2.0 * s if first else 2.0 * (1.0 - s)
        foot = lift[2] if first else end[2]
        z = foot + (apex - foot) * u * u * (3.0 - 2.0 * u)
        dz = (apex - foot) * 6.0 * u * (1.0 - u) * (2.0 if first else -2.0)
        ddz = (apex - foot) * 6.0 * (1.0 - 2.0 * u) * 4.0
    for i in range(2):
        out[0, i] = lift[i] + (end[i] - lift[i]) * w
        out[1, i], out[2, i] = (end[i] - lift[i]) * dw, (end[i] - lift[i]) * ddw
    out[0, 2], out[1, 2], out[2, 2] = z, dz, ddz
    for b in range(bends.shape[0]):
        span = 1.0 - bends[b, 0]
        r, dr, ddr = _quintic((s - bends[b, 0]) / span)
        for i in range(3):
            way = bends[b, i + 1]
            out[0, i] += way * r
            out[1, i] += way * dr / span
            out[2, i] += way * ddr / (span * span)
    for i in range(3):
        out[1, i] /= duration
        out[2, i] /= duration * duration
    if phase > 1.0:
        way, rate, acceleration = _searched((phase - 1.0) * duration, speed, path.depth, path.planned)
        out[1:] = 0.0
        out[0, 2] -= way
        out[1, 2], out[2, 2] = -rate, -acceleration


@kernel
def _positions(path: _Course, phases: Array, out: Array) -> None:
    """Write positions (n, 3) at phases (n,)."""
    motion = np.empty((3, 3))
    for k in range(phases.shape[0]):
        _motion(path, phases[k], motion)
        out[k] = motion[0]


@kernel
def _clears(path: _Course, foothold: Array, ground: Ground, radius: float, margin: float) -> bool:
    """Whether a foot on its way to a foothold (3,) clears the ground."""
    out, lift = np.empty((3, 3)), path.lift
    for k in range(_LOOKS):
        phase = k / (_LOOKS - 1.0)
        _motion(path, phase, out)
        x, y, z = out[0]
        # Where it stood and where it will stand the map may be off by a little; the foot is what tells.
        near = phase <= _NEAR or phase >= 1.0 - _NEAR
        least = z + 0.01 if near else z - margin
        if lowest_centre(ground, x, y, radius, True, least) <= least:
            continue
        away = min(np.hypot(lift[0] - x, lift[1] - y), np.hypot(foothold[0] - x, foothold[1] - y))
        if not (near and away < _STANDS_M):
            return False
    return True
