"""Floors that are not flat: a family of surface equations over 4 m × 4 m (QuadPiPS, section V-B1)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from legtool.sim.worlds.surface import Surface

Array = NDArray[np.float64]

SIDE_M = 4.0
RESOLUTION_M = 0.02
#: Width over which a surface comes down to the endless ground around it [m].
RIM_M = 0.5
#: Slopes are held below this, so that a floor is steppable all over.
STEEPEST = np.tan(np.deg2rad(25.0))


def _ridges(x: Array, y: Array, rng: np.random.Generator) -> Array:
    angle = rng.uniform(-np.pi, np.pi)
    along = np.cos(angle) * x + np.sin(angle) * y
    return np.sin(2 * np.pi * (along / rng.uniform(0.6, 2.0) + rng.uniform()))


def _waves(x: Array, y: Array, rng: np.random.Generator) -> Array:
    return _ridges(x, y, rng) * _ridges(x, y, rng)


def _mounds(x: Array, y: Array, rng: np.random.Generator) -> Array:
    z = np.zeros_like(x)
    for _ in range(int(rng.integers(4, 16))):
        centre = rng.uniform(-1.8, 1.8, 2)
        width = rng.uniform(0.15, 0.6)
        z += rng.uniform(-0.6, 1.0) * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * width**2))
    return z


def _saddle(x: Array, y: Array, rng: np.random.Generator) -> Array:
    angle = rng.uniform(-np.pi, np.pi)
    u, v = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    return (u**2 - v**2) / 4


def _bowl(x: Array, y: Array, rng: np.random.Generator) -> Array:
    return rng.choice([-1.0, 1.0]) * (x**2 + rng.uniform(0.3, 1.0) * y**2) / 4


def _rough(x: Array, y: Array, rng: np.random.Generator) -> Array:
    return sum((_ridges(x, y, rng) * 0.7**octave for octave in range(6)), np.zeros_like(x))


#: z(x, y) in arbitrary units over x, y [m] from the middle.
FAMILY: dict[str, Callable[[Array, Array, np.random.Generator], Array]] = {
    "ridges": _ridges,
    "waves": _waves,
    "mounds": _mounds,
    "saddle": _saddle,
    "bowl": _bowl,
    "rough": _rough,
}


def draw_floor(rng: np.random.Generator, centre: tuple[float, float], *, name: str | None = None) -> Surface:
    """A random surface that lies on the ground at z = 0 and comes down to it at its rim.

    Args:
        rng: draws the equation, where ``name`` is none, and its parameters.
        centre: world x, y of its middle [m].
        name: of an equation in FAMILY.
    """
    equation = FAMILY[name or str(rng.choice(list(FAMILY)))]
    points = round(SIDE_M / RESOLUTION_M) + 1
    axis = (np.arange(points) - (points - 1) / 2) * RESOLUTION_M
    x, y = np.meshgrid(axis, axis, indexing="ij")
    z = equation(x, y, rng)
    z -= z.min()
    inward = np.clip((SIDE_M / 2 - np.maximum(np.abs(x), np.abs(y))) / RIM_M, 0, 1)
    z *= inward * inward * (3 - 2 * inward)
    slope = np.hypot(*np.gradient(z, RESOLUTION_M)).max()
    z *= min(rng.uniform(0.03, 0.2) / z.max(), STEEPEST / slope)
    return Surface(z, RESOLUTION_M, np.array(centre) - SIDE_M / 2)
