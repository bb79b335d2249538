"""The true faces that carry feet, from above: the highest one at each place of a fine grid, and what stands on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.sim.worlds.carriers import Carriers, highest_carrier
from legtool.sim.worlds.raycast_kernels import BOX, CAPSULE, PLANE, SEMISPHERE, SPHERE, WEDGE
from legtool.sim.worlds.world import CYLINDRIC, FLOOR, WALL, World
from legtool_runtime.cache import kernel

Array = NDArray[np.float64]

#: What stands on a face reaches down to this far above it; it is then no place for a foot [m].
_ABOVE = 0.01


@dataclass(frozen=True, eq=False)
class FaceMap:
    """Faces of a world over a rectangle.

    Attributes:
        heights: (nx, ny) of the highest face [m]; -inf where there is none.
        faces: (nx, ny) its number, that of the primitive or surface it belongs to; -1 where there is none.
        free: (nx, ny) whether that is ground, and nothing stands there, and no wall.
        corner: (2,) world x, y of the outer corner of cell (0, 0); cell (i, j)'s centre lies half a cell further [m].
        resolution_m: side of a cell.
        surface: number of the floor that is not flat, -1 where there is none.
    """

    heights: NDArray[np.float32]
    faces: NDArray[np.int16]
    free: NDArray[np.bool_]
    corner: Array
    resolution_m: float
    surface: int


class Faces(NamedTuple):
    """Faces at places: (nx, ny) heights [m], numbers, and whether a foot may stand there, as in :class:`FaceMap`."""

    heights: Array
    numbers: NDArray[np.int16]
    free: NDArray[np.bool_]


def face_map(world: World, low: tuple[float, float], high: tuple[float, float], resolution_m: float) -> FaceMap:
    """Faces over the rectangle between two corners (world x, y) [m]."""
    nx, ny = (round((b - a) / resolution_m) for a, b in zip(low, high, strict=True))
    x = np.asarray(low[0] + (np.arange(nx) + 0.5) * resolution_m, dtype=np.float64)
    y = np.asarray(low[1] + (np.arange(ny) + 0.5) * resolution_m, dtype=np.float64)
    found = faces_at(world, x, y)
    surface = -1 if world.scene.surface is None else len(world.scene.kinds)
    heights = found.heights.astype(np.float32)
    return FaceMap(heights, found.numbers, found.free, np.array(low, dtype=float), resolution_m, surface)


def faces_at(world: World, x: Array, y: Array) -> Faces:
    """Faces at every pair of the places x (nx,) and y (ny,) [m]."""
    heights, rows = np.empty((len(x), len(y))), np.empty((len(x), len(y)), dtype=np.int64)
    _highest(world.carriers, x, y, heights, rows)
    scene = world.scene
    numbers = np.append(world.carriers.numbers, -1)[rows].astype(np.int16)
    if scene.surface is not None:
        floor = scene.surface.height(x[:, None], y)
        over = floor > heights
        heights, numbers = np.where(over, floor, heights), np.where(over, len(scene.kinds), numbers).astype(np.int16)
    free = (numbers >= 0) & world.ground[numbers] if len(world.ground) else np.zeros(rows.shape, dtype=bool)
    classes = world.classes[: len(scene.kinds)]
    for g in np.flatnonzero((classes > CYLINDRIC) & (classes != FLOOR)):
        if classes[g] == WALL and abs(scene.rotations[g][2, 2]) > 0.5:
            continue  # the ceiling
        _block(
            int(scene.kinds[g]), scene.sizes[g], scene.positions[g], scene.rotations[g], x, y, heights + _ABOVE, free
        )
    return Faces(heights, numbers, free)


@kernel
def _highest(carriers: Carriers, x: Array, y: Array, heights: Array, rows: NDArray[np.int64]) -> None:
    upright, turned = carriers.upright, carriers.turned
    for i in range(x.size):
        for j in range(y.size):
            heights[i, j], rows[i, j] = highest_carrier(upright, turned, x[i], y[j], np.inf)


@kernel
def _block(
    kind: int, size: Array, position: Array, rotation: Array, x: Array, y: Array, z: Array, free: NDArray[np.bool_]
) -> None:
    """Mark the cells whose point (x, y, z) lies inside a primitive, or behind a plane."""
    for i in range(x.size):
        for j in range(y.size):
            dx, dy, dz = x[i] - position[0], y[j] - position[1], z[i, j] - position[2]
            u = rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz
            v = rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz
            w = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
            if kind == PLANE:
                inside = w < 0.0
            elif kind in (SPHERE, SEMISPHERE):
                inside = u * u + v * v + w * w < size[0] ** 2 and (kind == SPHERE or w >= 0.0)
            elif kind == CAPSULE:
                beyond = max(abs(w) - size[2], 0.0)
                inside = u * u + v * v + beyond * beyond < size[0] ** 2
            elif kind in (BOX, WEDGE):
                inside = abs(u) < size[0] and abs(v) < size[1] and abs(w) < size[2]
            else:  # a cylinder, or a tube with its bore: a foot does not go in there
                inside = u * u + v * v < size[0] ** 2 and abs(w) < size[2]
            if inside:
                free[i, j] = False
