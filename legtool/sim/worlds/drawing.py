"""A world in words and as text, from above."""

from __future__ import annotations

from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.configs.world_parts import SHAPES
from legtool.sim.worlds.faces import faces_at
from legtool.sim.worlds.world import World

Array = NDArray[np.float64]

#: What is drawn beyond start and goal, along the way and across it [m].
_BEYOND_M, _BESIDE_M = 0.5, 1.0
#: Width of a line of the drawing: of a straight course, and of other worlds [m].
_COURSE_LINE_M, _LINE_M = 0.2, 0.1
#: Places that are looked at in a column, so that a gap narrower than it is seen.
_WITHIN = 9
#: As many primitives are listed one by one; of more, like ones together.
_LISTED = 12
_DIGITS = ".123456789abcdefghijklmnopqrstuvwxyz"


class Canvas(NamedTuple):
    """Middles of the drawing's columns (n,) and lines (m,), left first [m]."""

    x: Array
    y: Array


def draw_world(world: World, columns: int = 100) -> list[str]:
    """The world in words and as text, from above.

    Args:
        world: what to draw.
        columns: of the drawing, which reaches 0.5 m beyond start and goal.

    Returns:
        lines for a terminal: ``.`` ground at z = 0, a digit or letter its height in cm (a is 10), ``_`` lower ground,
        ``#`` what stands there and is no ground, a space the pit or nothing.
    """
    frame = _frame(world, columns)
    lines = [f"{world.name}: {_title(world)}"]
    if world.settings is not None and world.settings.source:
        lines += [f"  {world.settings.source}"]
    lines += _parts(world)
    cell = frame.x[1] - frame.x[0]
    ruler = [" "] * (columns + 4)
    for metre in range(int(np.ceil(frame.x[0])), int(frame.x[-1]) + 1):
        at = round((metre - frame.x[0]) / cell)
        ruler[at : at + len(str(metre))] = str(metre)
    lines += ["  from above, left side up; S start, G goal, floor in cm (a = 10)", "  " + "".join(ruler).rstrip()]
    text = _symbols(world, frame)
    for mark, place in (("G", world.goal), ("S", world.start)):
        if np.isfinite(place).all():
            row, column = int(np.argmin(np.abs(frame.y - place[1]))), round((place[0] - frame.x[0]) / cell)
            text[row][column] = mark
    return lines + ["  " + "".join(row) for row in text]


def _frame(world: World, columns: int) -> Canvas:
    settings = world.settings
    if settings is not None and settings.length is not None:
        x = np.linspace(-_BEYOND_M, settings.length + _BEYOND_M, columns)
        return Canvas(x, np.arange(settings.width / 2 - 0.1, -settings.width / 2, -_COURSE_LINE_M))
    places = [world.start[:2]]
    if np.isfinite(world.goal).all():
        places.append(world.goal)
    else:
        _, half = world.scene.half_extents()
        reach = np.abs(world.scene.rotations[:, :2]) @ np.where(np.isfinite(half), half, 0.0)[:, :, None]
        middle, reach = world.scene.positions[:, :2], reach[:, :, 0]
        places += [(middle - reach).min(axis=0), (middle + reach).max(axis=0)]
    low, high = np.min(places, axis=0), np.max(places, axis=0)
    along = int(high[1] - low[1] > high[0] - low[0])
    margin = np.full(2, _BESIDE_M)
    margin[along] = _BEYOND_M
    low, high = low - margin, high + margin
    lines = np.arange(high[1] - _LINE_M / 2, low[1], -_LINE_M)
    return Canvas(np.linspace(low[0], high[0], columns), lines)


def _symbols(world: World, frame: Canvas) -> list[list[str]]:
    """A symbol for each line and column: of each column the lowest place in it, so that a narrow gap is seen."""
    within = frame.x[:, None] + np.linspace(-0.5, 0.5, _WITHIN) * (frame.x[1] - frame.x[0])
    found = faces_at(world, within.ravel(), frame.y)
    ground = (found.numbers >= 0) & world.ground[found.numbers]
    pit = ~ground & (found.heights <= float(world.height(*world.start[:2])))
    shape = (*within.shape, len(frame.y))
    heights = found.heights.reshape(shape).min(axis=1)
    stood, pit = (np.asarray(mask.reshape(shape).any(axis=1)) for mask in (~found.free, pit))
    return [
        [_symbol(*place) for place in zip(*line, strict=True)] for line in zip(heights.T, pit.T, stood.T, strict=True)
    ]


def _symbol(height: float, pit: bool, stood: bool) -> str:
    if pit or stood:
        return " " if pit else "#"
    centimetres = round(100 * height)
    return "_" if centimetres < 0 else _DIGITS[min(centimetres, len(_DIGITS) - 1)]


def _title(world: World) -> str:
    settings = world.settings
    if settings is not None and settings.length is not None:
        return f"{settings.length:g} m to the goal, {settings.width:g} m wide, gaps {settings.pit_depth:g} m deep"
    x, y, yaw = world.start
    start = f"start ({x:g}, {y:g}), heading {np.rad2deg(yaw):.0f}°"
    if not np.isfinite(world.goal).all():
        return f"{start}, no goal"
    within = "" if world.goal_radius_m is None else f" within {world.goal_radius_m:g} m"
    away = np.hypot(*(world.goal - world.start[:2]))
    return f"{away:.2f} m to the goal; {start}, goal ({world.goal[0]:g}, {world.goal[1]:g}){within}"


def _parts(world: World) -> list[str]:
    settings = world.settings
    lines: list[str] = []
    n, skip = len(world.classes), 0
    if settings is not None and settings.length is not None:
        lines += [
            f"  gap  x {gap.x:.2f} to {gap.end:.2f} m, {100 * gap.width:.0f} cm, {gap.side}" for gap in settings.gaps
        ]
        lines += [
            f"  step x {step.x:.2f} to {step.end:.2f} m, {100 * step.height:.0f} cm up, {step.side}"
            for step in settings.steps
        ]
        skip = sum(name == "pit" or name.startswith("floor_") for name in world.names)
    numbers = range(skip, n)
    if len(numbers) <= _LISTED:
        return lines + [f"  {world.names[g]}: {_what(world, g)}, top {_cm(world.tops[g])}" for g in numbers]
    for what, alike in groupby(sorted(numbers, key=lambda g: _what(world, g)), key=lambda g: _what(world, g)):
        chosen = list(alike)
        tops = world.tops[chosen]
        lines.append(f"  {len(chosen)} × {what}, tops {_cm(tops.min())} to {_cm(tops.max())}")
    return lines


def _what(world: World, g: int) -> str:
    off = "" if world.ground[g] else ", off the course"
    return f"{SHAPES[world.classes[g]]}, friction {world.friction[g]:g}{off}"


def _cm(height: float) -> str:
    return f"{100 * height:.1f} cm".replace(".0 cm", " cm")
