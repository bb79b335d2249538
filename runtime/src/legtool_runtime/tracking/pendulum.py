"""The trunk as an inverted pendulum over the feet that stand: where it will be, and how far it diverges."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRAVITY = 9.81


class Planar(NamedTuple):
    """``position`` [m] and ``velocity`` [m/s] of the centre of mass, (2,) each, world frame."""

    position: Array
    velocity: Array

    def diverging(self, omega: float) -> Array:
        """(2,) ξ = c + v/ω, the part that grows [m]."""
        return self.position + self.velocity / omega


def frequency(height: float) -> float:
    """ω = √(g/h) [1/s] of a centre of mass at ``height`` over the mean of the feet [m]."""
    return math.sqrt(GRAVITY / max(height, 0.05))


def feedback(omega: float, swing_s: float) -> float:
    """k = 1 / (ω tanh(ω T)) [s]: foothold for a velocity that is off at touchdown, T the swing's duration."""
    return 1.0 / (omega * math.tanh(omega * swing_s))


def about_line(now: Planar, first: Array, second: Array, *, omega: float, wanted: Array, time_s: float) -> Planar:
    """Where the trunk is after ``time_s`` on two feet, as a pendulum about the line between them.

    Across the line, s = (c - p)·n:  s' = s cosh ωt + v/ω sinh ωt,  v' = s ω sinh ωt + v cosh ωt; along it the velocity
    goes over to the commanded one.

    Args:
        now: the centre of mass.
        first: (2,) a foot.
        second: (2,) the other foot.
        omega: ω [1/s].
        wanted: (2,) commanded velocity, world frame [m/s].
        time_s: until then.
    """
    line = np.asarray(second, np.float64) - np.asarray(first, np.float64)
    length = float(np.hypot(*line))
    if length < 0.05:
        return about_point(now, 0.5 * (first + second), omega=omega, time_s=time_s)
    along = line / length
    across = np.array([-along[1], along[0]])
    t = max(time_s, 0.0)
    cosh, sinh = math.cosh(omega * t), math.sinh(omega * t)
    off, speed = float((now.position - first) @ across), float(now.velocity @ across)
    moved, faster = off * cosh + speed / omega * sinh, off * omega * sinh + speed * cosh
    left, target = float(now.velocity @ along), float(np.asarray(wanted) @ along)
    decay = math.exp(-omega * t)
    way = target * t + (left - target) * (1.0 - decay) / omega
    position = first + along * (float((now.position - first) @ along) + way) + across * moved
    return Planar(position, along * (target + (left - target) * decay) + across * faster)


def about_point(now: Planar, centre: Array, *, omega: float, time_s: float) -> Planar:
    """Where the trunk is after ``time_s`` as a pendulum about a centre of pressure (2,), as in a crawl."""
    t = max(time_s, 0.0)
    cosh, sinh = math.cosh(omega * t), math.sinh(omega * t)
    off = now.position - centre
    return Planar(centre + off * cosh + now.velocity / omega * sinh, off * omega * sinh + now.velocity * cosh)
