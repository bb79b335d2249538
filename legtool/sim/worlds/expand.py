"""The short forms of a world's description as primitives."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.configs.world_parts import (
    SHAPES,
    Beam,
    Box,
    Cobbles,
    Cylinder,
    Profile,
    Ramp,
    Stairs,
    Stone,
    StoneGrid,
)
from legtool.configs.worlds import WorldSettings
from legtool.errors import SettingsError
from legtool.sim.worlds.raycast import Primitive, Scene, box, cylinder, wedge
from legtool.sim.worlds.world import CUBOID, CYLINDRIC, PIPE, RAMP
from legtool_runtime.rotations import from_angles

Array = NDArray[np.float64]

#: Platforms over a pit reach this far below its floor; a profile reaches this far below its lowest stretch [m].
_SUNK_M, _BELOW_M = 0.1, 0.5
#: Sides of cobbles, in cells: 16 to 24 cm [m].
_CELL_M, _COBBLE_CELLS = 0.02, (8, 13)
_UPRIGHT = np.eye(3)


class WorldPiece(NamedTuple):
    """A primitive with its class's number, its highest point [m], and whether its form says that it is no ground."""

    shape: int
    primitive: Primitive
    top: float
    ground: bool | None = None


def block(x: tuple[float, float], y: tuple[float, float], bottom: float, top: float) -> WorldPiece:
    """An upright box between two places along x and y."""
    low, high = np.array([x[0], y[0], bottom]), np.array([x[1], y[1], top])
    return WorldPiece(CUBOID, box((high + low) / 2, _UPRIGHT, ((high - low) / 2).tolist()), top)


def course(settings: WorldSettings) -> Iterator[WorldPiece]:
    """A straight course: for each half of the width, stretches between gaps at their heights."""
    assert settings.length is not None
    half, bottom = settings.width / 2, -settings.pit_depth - _SUNK_M
    for side, y in (("left", (0.0, half)), ("right", (-half, 0.0))):
        gaps = [gap for gap in settings.gaps if gap.side in ("both", side)]
        steps = [step for step in settings.steps if step.side in ("both", side)]
        edges = {-settings.run_in, settings.length + settings.run_in}
        edges |= {edge for gap in gaps for edge in (gap.x, gap.end)}
        edges |= {edge for step in steps for edge in (step.x, step.end)}
        for low, high in pairwise(sorted(edges)):
            middle = (low + high) / 2
            if not any(gap.x < middle < gap.end for gap in gaps):
                top = sum(step.height for step in steps if step.x < middle < step.end)
                yield block((low, high), y, bottom, top)


def profile(form: Profile) -> Iterator[WorldPiece]:
    """Stretches across the whole width."""
    half, bottom = form.width / 2, min(stretch.height for stretch in form.stretches) - _BELOW_M
    ends = [stretch.x for stretch in form.stretches[1:]] + [form.end]
    for stretch, end in zip(form.stretches, ends, strict=True):
        piece = block((stretch.x, end), (-half, half), bottom, stretch.height)
        yield piece if stretch.ground else piece._replace(ground=False)


def cobbles(form: Cobbles) -> Iterator[WorldPiece]:
    """Stones of 16 to 24 cm, cut off at the rims."""
    rng = np.random.default_rng(14 + form.seed)
    edges_x, edges_y = (np.cumsum(rng.integers(*_COBBLE_CELLS, count)) for count in (60, 40))
    tops = rng.uniform(0, form.height, (61, 41))
    along, across = (
        [place + _CELL_M * edge for edge in (0, *edges.tolist())]
        for place, edges in zip(form.first, (edges_x + 1, edges_y + 1), strict=True)
    )
    for i, (x_low, x_high) in enumerate(pairwise(along)):
        x_low, x_high = max(x_low, form.x[0]), min(x_high, form.x[1])
        for j, (y_low, y_high) in enumerate(pairwise(across)):
            y_low, y_high = max(y_low, form.y[0]), min(y_high, form.y[1])
            if x_low < x_high - 1e-9 and y_low < y_high - 1e-9:
                yield block((x_low, x_high), (y_low, y_high), -_BELOW_M, float(tops[i, j]))


def stairs(form: Stairs, floor: float) -> Iterator[WorldPiece]:
    """Each step is a block from the floor to its tread that reaches to the end of the flight."""
    turn = from_angles(0.0, 0.0, form.yaw)
    end = form.steps * form.tread + form.landing
    for step in range(form.steps):
        near, top = step * form.tread, floor + (step + 1) * form.riser
        middle = np.array([form.x, form.y, 0.0]) + turn @ np.array([(near + end) / 2, 0.0, 0.0])
        middle[2] = (floor + top) / 2
        yield WorldPiece(CUBOID, box(middle, turn, ((end - near) / 2, form.width / 2, (top - floor) / 2)), top)


def ramp(form: Ramp) -> WorldPiece:
    """A wedge."""
    turn = from_angles(0.0, 0.0, form.yaw)
    middle = np.array([form.x, form.y, form.z]) + turn @ np.array([form.length / 2, 0.0, form.height / 2])
    return WorldPiece(
        RAMP, wedge(middle, turn, (form.length / 2, form.width / 2, form.height / 2)), form.z + form.height
    )


def beam(form: Beam) -> WorldPiece:
    """A box along its two ends."""
    start, end = np.array(form.start), np.array(form.end)
    along = end - start
    middle = [*((start + end) / 2), form.top - form.thickness / 2]
    half = (float(np.hypot(*along)) / 2, form.width / 2, form.thickness / 2)
    return WorldPiece(CUBOID, box(middle, from_angles(0.0, 0.0, float(np.arctan2(along[1], along[0]))), half), form.top)


def stone(form: Stone, floor: float) -> WorldPiece:
    """A square or round column from the floor to its top."""
    if form.top <= floor:
        raise SettingsError(
            f"stone at ({form.x:g}, {form.y:g}): its top, {form.top:g} m, lies below the floor at {floor:g} m"
        )
    half = (form.top - floor) / 2
    middle = [form.x, form.y, form.top - half]
    turn = from_angles(0.0, 0.0, form.yaw)
    if form.radius is not None:
        return WorldPiece(CYLINDRIC, cylinder(middle, turn, form.radius, half), form.top)
    assert form.side is not None
    return WorldPiece(CUBOID, box(middle, turn, (form.side / 2, form.side / 2, half)), form.top)


def grid(form: StoneGrid) -> Iterator[Stone]:
    """Its stones, one draw after the other for each place, so that a stone that is missing moves no other."""
    rng = np.random.default_rng(form.seed)
    for i in range(form.rows):
        for j in range(form.columns):
            there, top, dx, dy = rng.uniform(size=4)
            if there < form.present:
                yield Stone(
                    x=form.x + i * form.pitch[0] + form.shift * (2 * dx - 1),
                    y=form.y + j * form.pitch[1] + form.shift * (2 * dy - 1),
                    top=form.top[0] + top * (form.top[1] - form.top[0]),
                    side=form.side,
                    radius=form.radius,
                )


def solid(form: Box | Cylinder) -> WorldPiece:
    """A box or cylinder that is written out."""
    turn = from_angles(*form.rpy)
    if isinstance(form, Box):
        a, b, c = form.size
        primitive, default = box(form.center, turn, (a / 2, b / 2, c / 2)), CUBOID
    else:
        primitive = cylinder(form.center, turn, form.radius, form.length / 2)
        default = CYLINDRIC if abs(turn[2, 2]) > _STANDS else PIPE
    shape = default if form.shape is None else SHAPES.index(form.shape)
    return WorldPiece(shape, primitive, highest_point(primitive))


#: A cylinder whose axis is no farther from the vertical than 45° stands; otherwise it lies.
_STANDS = 0.7


def highest_point(primitive: Primitive) -> float:
    """Height of a primitive's bounding box, which is a box's own highest corner [m]."""
    scene = Scene.of([primitive])
    _, half = scene.half_extents()
    return float(scene.positions[0, 2] + np.abs(scene.rotations[0, 2]) @ half[0])
