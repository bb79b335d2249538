"""From a world's settings to the world."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from legtool.configs.world_parts import Box, Cylinder, Part, Solid
from legtool.configs.worlds import WorldSettings
from legtool.errors import SettingsError
from legtool.sim.worlds import expand
from legtool.sim.worlds.builder import Builder
from legtool.sim.worlds.expand import WorldPiece
from legtool.sim.worlds.raycast import plane
from legtool.sim.worlds.shapes import place, written_piece
from legtool.sim.worlds.world import FLOOR, World
from legtool_runtime.perception import LABELS, UNKNOWN


def build_world(settings: WorldSettings, *, robot: str | None = None) -> World:
    """Build a world.

    Args:
        settings: its description.
        robot: name of the robot that is to walk there, for worlds with another start for some robots.

    Raises:
        SettingsError: the start or the goal lies on no ground.
    """
    builder = Builder(floor=False)
    floor = _add_floor(builder, settings)
    # Whether each primitive is ground, None where nobody has said so.
    said: list[bool | None] = [True] * len(builder.world.classes)
    for piece, form, name in _pieces(settings, floor):
        friction, label = settings.friction, UNKNOWN
        ground = piece.ground if form is None or form.ground is None else form.ground
        if form is not None and form.friction is not None:
            friction = form.friction
        if isinstance(form, Solid) and form.label is not None:
            label = LABELS.index(form.label)
        builder.add(piece.shape, piece.primitive, piece.top, name=name, friction=friction, ground=ground, label=label)
        said.append(ground)
    for number, shape in enumerate(settings.shapes):
        one = written_piece(shape)
        bottom = shape.z if shape.z > 0 else lowest_support(builder.world, one.reach, shape.x, shape.y)
        if not np.isfinite(bottom):
            raise SettingsError(
                f"world {settings.name}: shapes.{number} lies over no floor; give it z, or another place"
            )
        builder.add(one.number, *place(one, shape.x, shape.y, bottom, shape.yaw), friction=settings.friction)
        said.append(None)
    world = builder.build(settings.name, settings=settings, way=settings.way(robot))
    if settings.deepest is not None:
        world = _off_course(world, settings.deepest, said)
    _check(world)
    return world


def lowest_support(world: World, reach: float, x: float, y: float) -> float:
    """Height on which a shape with a footprint of radius ``reach`` stands at x, y: the lowest below it [m]."""
    offsets = 0.7 * reach * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
    return float(np.min(world.height(x + offsets[:, 0], y + offsets[:, 1])))


def _add_floor(builder: Builder, settings: WorldSettings) -> float:
    """Add the endless floor, and return the height from which stones and stairs rise [m]."""
    kind = settings.floor or ("pit" if settings.length is not None else "none" if settings.profile else "ground")
    if kind == "none":
        return 0.0
    height = 0.0 if kind == "ground" else -settings.pit_depth
    name = "floor" if kind == "ground" else "pit"
    builder.add(
        FLOOR, plane([0.0, 0.0, height], np.eye(3)), height, name=name, friction=settings.friction,
        ground=kind == "ground",
    )  # fmt: skip
    return height


def _pieces(settings: WorldSettings, floor: float) -> Iterator[tuple[WorldPiece, Part | None, str]]:
    """Everything but the endless floor and a scene's shapes: primitive, its form where it has one, its name."""
    if settings.length is not None:
        for number, piece in enumerate(expand.course(settings)):
            yield piece, None, f"floor_{number}"
    if settings.profile is not None:
        for piece in expand.profile(settings.profile):
            yield piece, None, ""
    for cobbles in settings.cobbles:
        for piece in expand.cobbles(cobbles):
            yield piece, cobbles, ""
    for stairs in settings.stairs:
        for piece in expand.stairs(stairs, floor):
            yield piece, stairs, ""
    for ramp in settings.ramps:
        yield expand.ramp(ramp), ramp, ""
    for beam in settings.beams:
        yield expand.beam(beam), beam, ""
    for stone in settings.stones:
        yield expand.stone(stone, floor), stone, ""
    for grid in settings.grids:
        for stone in expand.grid(grid):
            yield expand.stone(stone, floor), grid, ""
    solids: tuple[Box | Cylinder, ...] = (*settings.boxes, *settings.cylinders)
    for solid in solids:
        yield expand.solid(solid), solid, solid.name


def _off_course(world: World, deepest: float, said: list[bool | None]) -> World:
    """Take what lies too far below both start and goal for no ground, unless somebody has said otherwise."""
    ends = np.array([world.start[:2], world.goal])
    heights = world.height(ends[:, 0], ends[:, 1])
    lowest = float(np.min(heights, where=np.isfinite(heights), initial=np.inf))
    free = np.array([one is None for one in said], dtype=np.bool_)
    return replace(world, ground=world.ground & ~(free & (world.tops < lowest - deepest)))


def _check(world: World) -> None:
    """Refuse a walk that starts or ends where no foot may stand."""
    if not np.isfinite(world.goal).all():
        return
    around = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    circle = (world.goal_radius_m or 0.0) * np.column_stack([np.cos(around), np.sin(around)])
    places = {"start": world.start[None, :2], "goal": world.goal + np.concatenate([[[0, 0]], 0.5 * circle, circle])}
    for what, tried in places.items():
        heights = world.height(tried[:, 0], tried[:, 1])
        if not world.on_ground(np.column_stack([tried, heights])).any():
            where = f"{heights[0]:g} m high, where no foot may stand" if np.isfinite(heights[0]) else "over nothing"
            place = f"({tried[0, 0]:g}, {tried[0, 1]:g})"
            raise SettingsError(f"world {world.name}: the {what} {place} lies {where}; move it onto the ground")
