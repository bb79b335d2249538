"""The courses of ViTAL's experiments as heights, and how the robot is moved over them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.foothold import Gait
from legtool_runtime.terrain.elevation import HeightMap

CELL_M = 0.02
#: Step frequency of a robot that hardly moves [Hz], and by how much it rises with the speed [1/m].
_FREQUENCY, _RISE = 1.2, 1.0


@dataclass(frozen=True)
class Walk:
    """A kinematic walk over a course, along x of the world.

    Attributes:
        course: its name.
        speed: along x [m/s].
        heading: of the trunk against the walk's direction, at its start [rad]: 0 forwards, π/2 sideways.
        turn: of the trunk over the whole walk [rad].
        begin: x of the trunk's origin at the start [m].
        end: x at the end [m].
    """

    course: str
    speed: float
    heading: float = 0.0
    turn: float = 0.0
    begin: float = -0.9
    end: float = 3.2

    def yaw(self, x: float) -> float:
        """Yaw of the trunk at ``x`` [rad]."""
        return self.heading + self.turn * (x - self.begin) / (self.end - self.begin)

    def twist(self, x: float) -> tuple[float, ...]:
        """(6,) base twist at ``x``, horizontal frame."""
        yaw = self.yaw(x)
        rate = self.turn * self.speed / (self.end - self.begin)
        return (self.speed * math.cos(yaw), -self.speed * math.sin(yaw), 0.0, 0.0, 0.0, rate)

    @property
    def gait(self) -> Gait:
        """A trot whose steps get quicker and longer with the speed: 1.4 Hz at 0.2 m/s, 1.95 Hz at 0.75 m/s."""
        frequency = _FREQUENCY + _RISE * self.speed
        return Gait(self.speed / frequency, frequency, 0.55)


#: The paper's simulations (sections VI-A to VI-J): course, speed, and the lateral and yawing climbs.
WALKS = {
    "stairs": Walk("stairs", 0.2),
    "stairs_go28": Walk("stairs_go28", 0.25),
    "stairs_03": Walk("stairs", 0.3),
    "stairs_04": Walk("stairs", 0.4),
    "stairs_05": Walk("stairs", 0.5),
    "stairs_075": Walk("stairs", 0.75),
    "gapped_stairs": Walk("gapped_stairs", 0.4),
    "rough": Walk("rough", 0.2),
    "stairs_sideways": Walk("low_stairs", 0.2, heading=np.pi / 2),
    "stairs_yawing": Walk("stairs", 0.2, heading=-0.4, turn=0.8),
}


def course_heights(name: str, *, seed: int = 0, scale: float = 1.0) -> HeightMap:
    """A course from x = -2 to 4.5 m, y within ±1 m; it begins near x = 0 and ends near 2.3 m.

    Args:
        name: ``stairs`` (10 cm rise, 25 cm go), ``stairs_go28``, ``low_stairs``, ``gapped_stairs`` or ``rough``.
        seed: of the rough ground.
        scale: of the heights.
    """
    x = np.arange(-2.0, 4.5, CELL_M) + 0.5 * CELL_M
    y = np.arange(-1.0, 1.0, CELL_M) + 0.5 * CELL_M
    profile = {
        "stairs": lambda: _stairs(x, 0.10, 0.25, 3),
        "stairs_go28": lambda: _stairs(x, 0.10, 0.28, 3),
        "low_stairs": lambda: _stairs(x, 0.06, 0.40, 2),
        "gapped_stairs": lambda: _stairs(x, 0.10, 0.30, 3) - 0.4 * _gaps(x),
    }
    if name in profile:
        heights = np.repeat(profile[name]()[:, None], len(y), axis=1)
    else:
        heights = _cobbles(x, y, seed)
    return HeightMap((scale * heights).astype(np.float32), CELL_M, np.array([x.mean(), y.mean()]))


def _stairs(x: NDArray[np.float64], rise: float, go: float, steps: int) -> NDArray[np.float64]:
    """Up, a landing of 0.8 m, and down again."""
    up = np.clip(np.floor((x - 0.3) / go) + 1, 0, steps)
    top = 0.3 + (steps - 1) * go + 0.8
    down = np.clip(np.floor((x - top) / go) + 1, 0, steps)
    out: NDArray[np.float64] = rise * (up - down)
    return out


def _gaps(x: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Gaps of 6 cm at the landing and behind the first tread."""
    return ((x > 0.50) & (x < 0.56)) | ((x > 1.3) & (x < 1.36))


def _cobbles(x: NDArray[np.float64], y: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """Flat stones of 16 to 24 cm, up to 12 cm high."""
    rng = np.random.default_rng(14 + seed)
    edges_x, edges_y = (np.cumsum(rng.integers(8, 13, count)) for count in (60, 40))
    tops = rng.uniform(0, 0.12, (61, 41))
    h = tops[np.ix_(np.searchsorted(edges_x, np.arange(len(x))), np.searchsorted(edges_y, np.arange(len(y))))]
    inside = (x > 0.3) & (x < 2.3)
    return np.where(inside[:, None], h, 0.0)
