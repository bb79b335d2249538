"""Random terrain as heights: what the foothold line's heightmaps are cut from."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Side of a terrain [m], and of its cells.
SIDE_M, CELL_M = 2.8, 0.02
#: Least and largest ground between one bar or gap and the next [m]: room for a foot at least, for a stride at most.
_APART_M = (0.3, 1.1)


def random_terrain(kind: str, rng: np.random.Generator, *, scale: float = 1.0) -> Array:
    """(140, 140) heights [m] of one kind of terrain, its features sized for legs ``scale`` times those of HyQ."""
    n = round(SIDE_M / CELL_M)
    axis = (np.arange(n) - 0.5 * (n - 1)) * CELL_M
    x, y = np.meshgrid(axis, axis, indexing="ij")
    heights = _KINDS[kind](x, y, rng, scale)
    if rng.random() < 0.5:
        # Where the course begins: level ground before it.
        heights = np.where(_along(x, y, rng) > rng.uniform(-0.7, 0.7), heights, 0.0)
    return heights


def _along(x: Array, y: Array, rng: np.random.Generator) -> Array:
    angle = rng.uniform(-np.pi, np.pi)
    along: Array = np.cos(angle) * x + np.sin(angle) * y
    return along


def _bars(x: Array, y: Array, rng: np.random.Generator, scale: float) -> Array:
    along, h, place = _along(x, y, rng), np.zeros_like(x), -1.6
    while place < 1.6:
        place += rng.uniform(*_APART_M)
        width = rng.uniform(0.02, 0.15)
        h[(along > place) & (along < place + width)] = scale * rng.uniform(0.03, 0.2)
        place += width
    return h


def _gaps(x: Array, y: Array, rng: np.random.Generator, scale: float) -> Array:
    along, h, place = _along(x, y, rng), np.zeros_like(x), -1.6
    while place < 1.6:
        place += rng.uniform(*_APART_M)
        width = scale * rng.uniform(0.04, 0.25)
        h[(along > place) & (along < place + width)] = -rng.uniform(0.1, 0.6)
        place += width
    return h


def _stairs(x: Array, y: Array, rng: np.random.Generator, scale: float) -> Array:
    along = _along(x, y, rng) + rng.uniform(-0.5, 0.5)
    rise, go = scale * rng.uniform(0.04, 0.16), rng.uniform(0.2, 0.4)
    first, steps = -go * rng.integers(0, 4), int(rng.integers(1, 7))
    climbed = np.clip(np.floor((along - first) / go) + 1, 0, steps)
    h: Array = rise * climbed
    if rng.random() < 0.3:
        # Gapped stairs: treads that are shorter than their go.
        inside = (climbed > 0) & (climbed < steps)
        h[inside & (np.mod(along - first, go) > go - rng.uniform(0.03, 0.1))] -= rng.uniform(0.2, 0.6)
    return h


def _window(x: Array, cx: float, cy: float, reach: float) -> tuple[slice, slice]:
    """The cells within ``reach`` of a place along both axes."""
    n = len(x)
    low = [max(int((c - reach) / CELL_M + 0.5 * n), 0) for c in (cx, cy)]
    high = [min(int((c + reach) / CELL_M + 0.5 * n) + 1, n) for c in (cx, cy)]
    return slice(low[0], high[0]), slice(low[1], high[1])


def _blocks(x: Array, y: Array, rng: np.random.Generator, count: int, size: tuple[float, float], top: float) -> Array:
    h = np.zeros_like(x)
    for _ in range(count):
        angle, cx, cy = rng.uniform(0, np.pi), *rng.uniform(-1.4, 1.4, 2)
        c, s = np.cos(angle), np.sin(angle)
        near = _window(x, cx, cy, size[1])
        dx, dy = x[near] - cx, y[near] - cy
        inside = np.abs(c * dx + s * dy) < 0.5 * rng.uniform(*size)
        inside &= np.abs(-s * dx + c * dy) < 0.5 * rng.uniform(*size)
        h[near] = np.maximum(h[near], inside * rng.uniform(0.1, 1.0) * top)
    return h


def _rocks(x: Array, y: Array, rng: np.random.Generator, scale: float) -> Array:
    h = np.zeros_like(x)
    for _ in range(int(rng.integers(10, 50))):
        cx, cy = rng.uniform(-1.4, 1.4, 2)
        radius, top = rng.uniform(0.04, 0.25), scale * rng.uniform(0.02, 0.16)
        near = _window(x, cx, cy, radius)
        bump = top * np.sqrt(np.maximum(1 - ((x[near] - cx) ** 2 + (y[near] - cy) ** 2) / radius**2, 0))
        h[near] = np.maximum(h[near], np.minimum(bump, rng.uniform(0.6, 1.0) * top))
    return h


def _ramps(x: Array, y: Array, rng: np.random.Generator, scale: float) -> Array:
    along = _along(x, y, rng) + rng.uniform(-0.4, 0.4)
    slope, length = rng.uniform(-0.6, 0.6), rng.uniform(0.3, 2.0)
    return slope * np.clip(along, 0, length)


def _stones(x: Array, y: Array, rng: np.random.Generator, scale: float) -> Array:
    tops = _blocks(x, y, rng, int(rng.integers(70, 150)), (0.2, 0.6), 1.0)
    spread, depth = scale * rng.uniform(0, 0.06), rng.uniform(0.15, 0.6)
    return np.where(tops > 0, tops * spread, -depth)


def _rough(x: Array, y: Array, rng: np.random.Generator, scale: float) -> Array:
    h = np.zeros_like(x)
    for _ in range(40):
        k = rng.normal(scale=rng.choice([4.0, 12.0, 25.0]), size=2)
        h += np.cos(k[0] * x + k[1] * y + rng.uniform(0, 2 * np.pi)) / (4.0 + np.hypot(*k))
    h *= scale * rng.uniform(0.005, 0.05) / h.std()
    if rng.random() < 0.5:
        # Cobbles: flat tops at the surface's heights.
        side = round(rng.uniform(0.1, 0.3) / CELL_M)
        cells = np.arange(len(x)) // side * side
        h = h[np.ix_(cells, cells)]
    return h


def _mixture(x: Array, y: Array, rng: np.random.Generator, scale: float) -> Array:
    kinds = rng.choice([name for name in _KINDS if name != "mixture"], 2, replace=False)
    one, other = (_KINDS[kind](x, y, rng, scale) for kind in kinds)
    if rng.random() < 0.5:
        return one + 0.7 * other
    return np.where(_along(x, y, rng) > rng.uniform(-0.3, 0.3), one, other)


_KINDS: dict[str, Callable[[Array, Array, np.random.Generator, float], Array]] = {
    "bars": _bars,
    "gaps": _gaps,
    "stairs": _stairs,
    "rocks": _rocks,
    "ramps": _ramps,
    "stones": _stones,
    "rough": _rough,
    "mixture": _mixture,
}
