"""The world: primitives with classes and friction, a start, a goal, and what counts as ground.

Everything that stands for a world elsewhere is made from this: MuJoCo's world, depth images, labels, the face map,
elevation maps and drawings.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.configs.world_parts import SHAPES
from legtool.configs.worlds import WorldSettings
from legtool.errors import SettingsError
from legtool.sim.worlds.carriers import Carriers, carriers_of, faces_below, highest_faces
from legtool.sim.worlds.raycast import Scene
from legtool.sim.worlds.raycast_kernels import PLANE

Array = NDArray[np.float64]

CUBOID, RAMP, CYLINDRIC, SPHERIC, SEMISPHERIC, POLE, PIPE, TUBULAR, FLOOR, WALL = range(len(SHAPES))

#: A foot stands on ground where its lowest point is within this of it [m].
CLEAN_HEIGHT_M = 0.025
#: Half of the width of cracks that no foot fits into: a ball of 2 cm sinks 0.1 mm into one of twice as much [m].
_CRACK_M = 0.002
#: Places on both sides of a crack, in four directions; those of a pair are four rows apart.
_BESIDE = _CRACK_M * np.array([[np.cos(a), np.sin(a), 0.0] for a in np.arange(8) * np.pi / 4])


@dataclass(frozen=True, eq=False)
class World:
    """A world; its n primitives are numbered as the ray caster numbers them, a surface of heights last.

    Attributes:
        name: of the world.
        settings: what it was built from; None for scenes that are drawn for training.
        scene: the primitives, and a surface that lies on the floor.
        classes: (n,) index into SHAPES.
        tops: (n,) highest point of each [m]; of floors and walls that are planes it means nothing.
        friction: (n,) sliding friction.
        ground: (n,) whether a foot may stand on its upward faces; False is off the course, such as a pit's floor.
        labels: (n,) label that all faces of it have; ``UNKNOWN`` where each goes by its place.
        names: (n,) of each, all different.
        start: (3,) x, y [m], yaw [rad] of the robot.
        goal: (2,) x, y [m]; NaN where there is none.
        goal_radius_m: the goal is reached this near to it; None: at the line through it, across the way from the start.
        via: (m, 2) places to pass before the goal, in this order [m].
    """

    name: str
    settings: WorldSettings | None
    scene: Scene
    classes: NDArray[np.uint8]
    tops: Array
    friction: Array
    ground: NDArray[np.bool_]
    labels: NDArray[np.uint8]
    names: tuple[str, ...]
    start: Array
    goal: Array
    goal_radius_m: float | None
    via: Array = field(default_factory=lambda: np.empty((0, 2)))

    @cached_property
    def carriers(self) -> Carriers:
        """What carries feet: floors, cuboids, ramps and standing cylinders."""
        n = len(self.scene.kinds)
        classes = self.classes[:n]
        floors = (classes == FLOOR) & ((self.scene.kinds != PLANE) | (self.scene.rotations[:, 2, 2] > 0))
        return carriers_of(self.scene, (classes <= CYLINDRIC) | floors, self.ground[:n])

    def height(self, x: ArrayLike, y: ArrayLike, *, below: float = np.inf) -> Array:
        """Height of the highest carrier at a place, a pit's floor included.

        Args:
            x, y: broadcastable world coordinates [m].
            below: only carriers lower than this count [m].

        Returns:
            their broadcast shape [m]; -inf where nothing is.
        """
        x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        heights, rows = np.empty(x.size), np.empty(x.size, dtype=np.int64)
        highest_faces(self.carriers, x.ravel(), y.ravel(), below, heights, rows)
        out = heights.reshape(x.shape)
        if self.scene.surface is not None:
            out = np.maximum(out, self.scene.surface.height(x, y))
        return out

    def on_ground(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether feet stand where a foot may stand: the judge of clean steps for every line.

        A foot stands on the face nearest below its lowest point, or up to ``CLEAN_HEIGHT_M`` above it, where that face
        is a top and ground, and no farther away than that. Anything else is a misstep: a foot beside the ground, in a
        pit, also on the pit's floor, against a riser, or hung up on an edge. Over a crack of less than 4 mm, as between
        a ramp and the platform that it leads to, a foot stands on both sides.

        Args:
            points: (n, 3) lowest points of feet, world frame [m].

        Returns:
            (n,).
        """
        points = np.ascontiguousarray(np.atleast_2d(np.asarray(points, dtype=float)))
        stand = self._stands(points)
        off = np.flatnonzero(~stand)
        beside = self._stands((points[off, None] + _BESIDE).reshape(-1, 3)).reshape(len(off), 2, 4)
        stand[off] = (beside[:, 0] & beside[:, 1]).any(axis=1)
        return stand

    def _stands(self, points: Array) -> NDArray[np.bool_]:
        """(n,) whether points (n, 3) are on ground, as if a foot were a point."""
        heights, stand = np.empty(len(points)), np.empty(len(points), dtype=np.bool_)
        faces_below(self.carriers, points, CLEAN_HEIGHT_M, heights, stand)
        surface = self.scene.surface
        if surface is not None:
            floor = surface.height(points[:, 0], points[:, 1])
            over = (floor > heights) & (floor <= points[:, 2] + CLEAN_HEIGHT_M)
            heights, stand = np.where(over, floor, heights), np.where(over, self.ground[-1], stand)
        return stand & (points[:, 2] <= heights + CLEAN_HEIGHT_M)

    def remaining(self, position: ArrayLike) -> float:
        """Distance that is left to the goal's circle, or to the finish line [m]; at most 0 where it is reached.

        Args:
            position: (2,) or longer, x and y of the robot [m].

        Raises:
            SettingsError: the world has no goal.
        """
        self.require_goal()
        away = self.goal - np.asarray(position, dtype=float)[:2]
        if self.goal_radius_m is not None:
            return float(np.hypot(*away)) - self.goal_radius_m
        way = self.goal - self.start[:2]
        length = float(np.hypot(*way))
        ahead = way / length if length > 0 else np.array([np.cos(self.start[2]), np.sin(self.start[2])])
        return float(away @ ahead)

    def points(self) -> Array:
        """(m + 1, 2) where the way leads, one after the other, the goal last; x, y [m]."""
        return np.concatenate([self.via, self.goal[None]])

    def require_goal(self) -> None:
        """Refuse a world that cannot be walked.

        Raises:
            SettingsError: it has no goal.
        """
        if not np.isfinite(self.goal).all():
            raise SettingsError(f"world {self.name}: it has no goal, and a walk needs one; give its file goal: [x, y]")
