"""Collects primitives into a world."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from legtool.configs.world_parts import SHAPES
from legtool.configs.worlds import Way, WorldSettings
from legtool.sim.worlds.raycast import Primitive, Scene, plane
from legtool.sim.worlds.surface import Surface
from legtool.sim.worlds.world import FLOOR, World
from legtool_runtime.perception import STEPPABLE, UNKNOWN

#: Sliding friction of what has none of its own.
FRICTION = 0.8


class Row(NamedTuple):
    """What a world knows of one primitive beside its geometry."""

    shape: int
    top: float
    friction: float
    ground: bool
    label: int
    name: str


class Builder:
    """Collects primitives into a world, whose first one is an endless floor at z = 0 unless ``floor`` is False."""

    def __init__(self, surface: Surface | None = None, *, floor: bool = True) -> None:
        self._surface = surface
        self._primitives: list[Primitive] = []
        self._rows: list[Row] = []
        self._world: World | None = None
        if floor:
            self.add(FLOOR, plane([0.0, 0.0, 0.0], np.eye(3)), 0.0, name="floor")

    @property
    def world(self) -> World:
        """The world so far, without a goal."""
        if self._world is None:
            self._world = self.build("scene")
        return self._world

    def add(
        self,
        shape: int,
        primitive: Primitive,
        top: float,
        *,
        name: str = "",
        friction: float = FRICTION,
        ground: bool | None = None,
        label: int = UNKNOWN,
    ) -> None:
        """Add a primitive.

        Args:
            shape: number of its class in SHAPES.
            primitive: its geometry.
            top: highest point [m].
            name: of its own; none: its class with its number.
            friction: sliding.
            ground: whether a foot may stand on it; None: yes, unless it is labelled passable or non-passable.
            label: of all its faces; UNKNOWN: each by its place.
        """
        if ground is None:
            ground = label in (UNKNOWN, STEPPABLE)
        name = name or f"{SHAPES[shape]}_{len(self._primitives)}"
        self._primitives.append(primitive)
        self._rows.append(Row(shape, top, friction, ground, label, name))
        self._world = None

    def build(self, name: str, *, settings: WorldSettings | None = None, way: Way | None = None) -> World:
        """The world of what was added, with a name, a start and a goal."""
        way = way or Way()
        rows = list(self._rows)
        if self._surface is not None:
            rows.append(Row(FLOOR, 0.0, FRICTION, True, UNKNOWN, "surface"))
        return World(
            name=name,
            settings=settings,
            scene=Scene.of(self._primitives, self._surface),
            classes=np.array([row.shape for row in rows], dtype=np.uint8),
            tops=np.array([row.top for row in rows], dtype=float),
            friction=np.array([row.friction for row in rows], dtype=float),
            ground=np.array([row.ground for row in rows], dtype=np.bool_),
            labels=np.array([row.label for row in rows], dtype=np.uint8),
            names=_distinct([row.name for row in rows]),
            start=np.array(way.start),
            goal=np.full(2, np.nan) if way.goal is None else np.array(way.goal),
            goal_radius_m=way.goal_radius,
            via=np.array(way.via, dtype=float).reshape(-1, 2),
        )


def _distinct(names: list[str]) -> tuple[str, ...]:
    """The names, with their numbers where an earlier one is the same."""
    taken: set[str] = set()
    out = []
    for number, name in enumerate(names):
        free = name
        while free in taken:
            free += f"_{number}"
        taken.add(free)
        out.append(free)
    return tuple(out)
